"""Data sets of bodies: from shards, or from the folder published with GarmentCodeData."""

import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, SupportsIndex, overload

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, Subset

from gcd_dataset.bodies import POSES, BodyMesh, Person, measure_row
from gcd_dataset.files import user_path
from gcd_dataset.loaders.base import (
    GarmentItem,
    Transform,
    UnknownKeyError,
    index_list,
    recipe_from_meta,
    require_callable,
    require_float_dtype,
    resolve_index,
    tensor_of,
    wrap_item,
)
from gcd_dataset.loaders.fields import BodyFields
from gcd_dataset.records import MEASURES
from gcd_dataset.release.bodies import PublishedPeople
from gcd_dataset.shards.body_set import MEMBER_OF, decode_body_fields, decode_person, read_set_mesh
from gcd_dataset.shards.layout import BODIES, select_fields
from gcd_dataset.shards.reader import ShardReader, Verify

FIELDS = ("name", "shape", "arm_angle", "measures", *POSES)


class Bodies(Dataset[BodyFields], ABC):
    """People by index, each in two poses; all on one mesh, so that a plain ``DataLoader`` stacks them.

    Items are ``BodyFields``. ``fields`` selects the fields of an item, ``None`` all; ``transform`` is called with each
    item; ``dtype`` is the floating type, ``None`` the stored one. ``people[[3, 5]]`` is a list of items,
    ``people[2:5]`` a data set.
    """

    columns: tuple[str, ...] = MEASURES
    """Names of the entries of ``measures``."""

    def __init__(
        self, fields: Iterable[str] | None, transform: Transform | None, *, dtype: torch.dtype | None = torch.float32
    ) -> None:
        self.fields = select_fields(fields, FIELDS)
        self.transform = None if transform is None else require_callable("transform", transform)
        self.dtype = require_float_dtype(dtype)

    @property
    @abstractmethod
    def mesh(self) -> BodyMesh:
        """Triangles and body parts, shared by all bodies."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def person(self, index: int) -> Person:
        """Person ``index`` in full precision, ready to be dressed. Raises ``IndexError``."""

    @abstractmethod
    def _values(self, position: int) -> Mapping[str, Any]:
        """The stored values of at least ``self.fields``."""

    @property
    def faces(self) -> Tensor:
        """int32 [f, 3]: triangles, rows of ``straight`` and ``apart``."""
        return torch.from_numpy(np.array(self.mesh.faces, np.int32))

    @property
    def parts(self) -> Tensor | None:
        """u8 [v]: ``BodyPart`` value of each vertex; ``None`` if unknown."""
        return None if self.mesh.parts is None else torch.from_numpy(np.array(self.mesh.parts))

    @overload
    def __getitem__(self, index: slice) -> Subset[BodyFields]: ...
    @overload
    def __getitem__(self, index: SupportsIndex | str) -> BodyFields: ...
    @overload
    def __getitem__(self, index: Sequence[int] | list[str]) -> list[BodyFields]: ...
    def __getitem__(self, index: Any) -> Any:
        """The item of an index or name; a list of items for several, a data set for a slice.

        Raises ``IndexError``, ``KeyError`` for an unknown name, ``TypeError`` for a value that is no index.
        """
        if isinstance(index, slice):
            return Subset(self, range(len(self))[index])
        several = index_list(index)
        return self._load(self._position(index)) if several is None else [self[each] for each in several]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self)} people: {', '.join(self.fields)})"

    def __iter__(self) -> Iterator[BodyFields]:
        return (self[index] for index in range(len(self)))

    def _load(self, position: int) -> Any:
        values = self._values(position)
        item = GarmentItem(
            (field, value if isinstance(value := values[field], str) else tensor_of(np.asarray(value), self.dtype))
            for field in self.fields
        )
        return item if self.transform is None else wrap_item(self.transform(item))

    def _position(self, index: int | str) -> int:
        return self._find_name(index) if isinstance(index, str) else resolve_index(index, len(self), "person")

    def _find_name(self, name: str) -> int:
        """The position of the person with a name. Raises ``UnknownKeyError``."""
        names = self._names()
        try:
            return names.index(name)
        except ValueError:
            near = get_close_matches(name, names, n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"names are like {names[0]}"
            raise UnknownKeyError(f"no person {name!r:.99}: {hint}") from None

    @abstractmethod
    def _names(self) -> Sequence[str]:
        """Names of all people, in order."""


class BodyDataset(Bodies):
    """People in a folder of shards, as made by ``gcd generate --stage body``.

    >>> ds = BodyDataset("bodies", fields=("measures", "straight"))  # doctest: +SKIP
    >>> ds[0]["straight"].shape, ds[0]["measures"][ds.columns.index("waist")]  # doctest: +SKIP
    (torch.Size([25128, 3]), tensor(81.5200))

    Vertices are multiples of 2⁻⁹ cm, within 1e-3 cm of the body model's. ``verify``: ``lazy`` checks a member's CRC-32
    when a process reads it for the first time, ``full`` checks everything on opening, ``off`` nothing. ``partial``:
    ``True`` opens a folder whose run was stopped without a warning. Raises
    ``ShardError`` for a folder without such a split, or a damaged or foreign one.
    """

    def __init__(
        self,
        source: str | Path,
        split: str = "train",
        fields: Iterable[str] | None = None,
        *,
        transform: Transform | None = None,
        verify: Verify = "lazy",
        partial: bool = False,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        super().__init__(fields, transform, dtype=dtype)
        self._reader = ShardReader(source, split, layout=BODIES, verify=verify)
        if not partial:
            self._reader.store.warn_unfinished([split])
        self._mesh = read_set_mesh(user_path(source), split, self.recipe(0)["recipe"]["mesh"])

    @property
    def mesh(self) -> BodyMesh:
        return self._mesh

    def __len__(self) -> int:
        return len(self._reader)

    def person(self, index: int) -> Person:
        return decode_person(self._reader.read(self._position(index), BODIES.members))

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that person ``index`` was made with. Raises ``IndexError``."""
        return recipe_from_meta(self._reader.read(self._position(index), ["meta.json"])["meta.json"])

    def identity(self) -> dict[str, Any]:
        """Identity of the data set: its length, and the recipes of its first and last person."""
        recipes = map(self.recipe, (0, -1))
        ends = [{name: recipe[name] for name in ("seed", "index", "recipe")} for recipe in recipes]
        return {"length": len(self), "ends": ends}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` with shard, key and member if the bytes of person ``index`` are not those written."""
        self._reader.check(self._position(index))

    def _names(self) -> Sequence[str]:
        return [
            decode_body_fields(self._reader.read(position, [MEMBER_OF["name"]]), ["name"])["name"]
            for position in range(len(self))
        ]

    def _values(self, position: int) -> Mapping[str, Any]:
        return decode_body_fields(self._reader.read(position, {MEMBER_OF[field] for field in self.fields}), self.fields)


class PublishedBodies(Bodies):
    """People in the folder ``5000_body_shapes_and_measures`` published with GarmentCodeData, unconverted.

    >>> ds = PublishedBodies("GarmentCodeData_v2", fields=("measures", "straight"))  # doctest: +SKIP
    >>> ds[ds.names.index("00345")]["straight"].shape  # doctest: +SKIP
    torch.Size([23752, 3])

    ``names``: the people to read, by default all. ``segmentation``: GarmentCode's ``ggg_body_segmentation.json``, for
    the body parts. The sign of ``arm_angle`` is that of the authors' rig, see ``PublishedPeople.shape``. Raises
    ``ShardError`` with the first missing file of those that the fields need, ``BodyError`` for an invalid file.
    """

    def __init__(
        self,
        root: str | Path,
        fields: Iterable[str] | None = None,
        *,
        names: Sequence[str] | None = None,
        segmentation: str | Path | None = None,
        transform: Transform | None = None,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        super().__init__(fields, transform, dtype=dtype)
        file_of = {"shape": "meta", "arm_angle": "meta"}
        needed = dict.fromkeys(file_of.get(field, field) for field in self.fields if field != "name")
        self._people = PublishedPeople(root, names=names, needed=needed, segmentation=segmentation)
        self.names = self._people.names

    @property
    def mesh(self) -> BodyMesh:
        return self._people.mesh

    def __len__(self) -> int:
        return len(self.names)

    def identity(self) -> dict[str, Any]:
        """Identity of the data set: its first and last name, and a checksum of all."""
        return {"ends": [self.names[0], self.names[-1]], "names": zlib.crc32("\n".join(self.names).encode())}

    def person(self, index: int) -> Person:
        return self._people.person(self.names[self._position(index)])

    def _names(self) -> Sequence[str]:
        return self.names

    def _values(self, position: int) -> Mapping[str, Any]:
        name, fields = self.names[position], set(self.fields)
        values: dict[str, Any] = {"name": name}
        if fields & {"shape", "arm_angle"}:
            shape = self._people.shape(name)
            values |= {"shape": shape.weights, "arm_angle": shape.arm_angle}
        if "measures" in fields:
            values["measures"] = measure_row(self._people.measurements(name))
        return values | {pose: self._people.vertices(name, pose) for pose in POSES if pose in fields}
