"""Bodies for a ``torch.utils.data.DataLoader``: from shards, or from the folder that came with GarmentCodeData."""

import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, Subset

from gcd_dataset.bodies import POSES, BodyMesh, Person, measure_row
from gcd_dataset.files import user_path
from gcd_dataset.loaders.base import GarmentItem, Item, Transform, floating, function, kept_item, made_with, tensor_of
from gcd_dataset.loaders.indexing import UnknownKeyError, index_of, several_of
from gcd_dataset.records import MEASURES
from gcd_dataset.release.body_folder import PublishedPeople
from gcd_dataset.shards.body_set import MEMBER_OF, decode_body_fields, decode_person, read_set_mesh
from gcd_dataset.shards.layout import BODIES, select_fields
from gcd_dataset.shards.reader import ShardReader, Verify

__all__ = ["Bodies", "BodyDataset", "PublishedBodies"]

FIELDS = ("name", "shape", "arm_angle", "measures", *POSES)


class Bodies(Dataset[Item], ABC):
    """People by number, each in two poses; all on one mesh, so that a plain ``DataLoader`` stacks them.

    =====================  =========================================================================================
    ``name``               what the person is called
    ``shape``              f32 [k]: weights of the shape components [standard deviations]
    ``arm_angle``          f32 []: how far both arms are raised from the A-pose [rad]
    ``measures``           f32 [26], in the order of ``columns``: cm, inclinations in degrees; NaN where none was taken
    ``straight, apart``    f32 [v, 3]: vertices with the legs straight, and with the legs apart [cm], soles at y = 0
    =====================  =========================================================================================

    ``fields`` chooses what an item holds, all for ``None``; ``transform`` changes it on the way out; ``dtype`` is
    that of the numbers, and ``None`` what is stored. ``people[[3, 5]]`` is a list of items, ``people[2:5]`` a data set.
    """

    columns: tuple[str, ...] = MEASURES
    """Names of the entries of ``measures``."""

    def __init__(
        self,
        fields: Iterable[str] | None,
        transform: Transform | None,
        *,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        self.fields = select_fields(fields, FIELDS)
        self.transform = None if transform is None else function("transform", transform)
        self.dtype = floating(dtype)

    @property
    @abstractmethod
    def mesh(self) -> BodyMesh:
        """Triangles and parts, which all bodies share."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def person(self, index: int) -> Person:
        """Person ``index`` with every digit, ready to be dressed. Raises ``IndexError``."""

    @abstractmethod
    def _values(self, position: int) -> Mapping[str, Any]:
        """The fields as they are stored, ``self.fields`` at least."""

    @property
    def faces(self) -> Tensor:
        """int32 [f, 3]: triangles, rows of ``straight`` and ``apart``."""
        return torch.from_numpy(np.array(self.mesh.faces, np.int32))

    @property
    def parts(self) -> Tensor | None:
        """u8 [v]: ``BodyPart`` value of each vertex; ``None`` where nobody has said."""
        return None if self.mesh.parts is None else torch.from_numpy(np.array(self.mesh.parts))

    def __getitem__(self, index: Any) -> Any:
        """Person ``index``, a number or what the person is called; several for a list, a data set for a slice.

        Raises ``IndexError``, ``KeyError`` for a name that nobody has, ``TypeError`` for what is no index.
        """
        if isinstance(index, slice):
            return Subset(self, range(len(self))[index])
        several = several_of(index)
        return self._one(self._position(index)) if several is None else [self[each] for each in several]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self)} people: {', '.join(self.fields)})"

    def __iter__(self) -> Iterator[Any]:
        """Everybody in order."""
        return (self[index] for index in range(len(self)))

    def _one(self, position: int) -> Any:
        values = self._values(position)
        item = GarmentItem(
            (field, value if isinstance(value := values[field], str) else _tensor(value, self.dtype))
            for field in self.fields
        )
        return item if self.transform is None else kept_item(self.transform(item))

    def _position(self, index: int | str) -> int:
        return self._called(index) if isinstance(index, str) else index_of(index, len(self), "person")

    def _called(self, name: str) -> int:
        """The position of the person of a name. Raises ``UnknownKeyError``."""
        names = self._names()
        try:
            return names.index(name)
        except ValueError:
            near = get_close_matches(name, names, n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"they are called {names[0]} and the like"
            raise UnknownKeyError(f"no person {name!r:.99}: {hint}") from None

    @abstractmethod
    def _names(self) -> Sequence[str]:
        """What everybody is called, in order."""


class BodyDataset(Bodies):
    """People in a folder of shards, as ``gcd generate --stage body`` makes them.

    >>> ds = BodyDataset("bodies", fields=("measures", "straight"))  # doctest: +SKIP
    >>> ds[0]["straight"].shape, ds[0]["measures"][ds.columns.index("waist")]  # doctest: +SKIP
    (torch.Size([25128, 3]), tensor(81.5200))

    ``verify``: ``lazy`` checks a member's CRC-32 the first time that a process reads it, ``full`` checks everything at
    once, ``off`` nothing. Raises ``ShardError`` for a folder that holds no such split, or a broken or foreign one.
    """

    def __init__(
        self,
        source: str | Path,
        split: str = "train",
        fields: Iterable[str] | None = None,
        *,
        transform: Transform | None = None,
        verify: Verify = "lazy",
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        super().__init__(fields, transform, dtype=dtype)
        self._reader = ShardReader(source, split, layout=BODIES, verify=verify)
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
        return made_with(self._reader.read(self._position(index), ["meta.json"])["meta.json"])

    def identity(self) -> dict[str, Any]:
        """What tells these people from others: how many, and how the first and the last were made."""
        made = [{name: end[name] for name in ("seed", "index", "recipe")} for end in map(self.recipe, (0, -1))]
        return {"length": len(self), "ends": made}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` with shard, key and member if a byte of person ``index`` is not as it was written."""
        self._reader.check(self._position(index))

    def _names(self) -> Sequence[str]:
        return [
            decode_body_fields(self._reader.read(position, [MEMBER_OF["name"]]), ["name"])["name"]
            for position in range(len(self))
        ]

    def _values(self, position: int) -> Mapping[str, Any]:
        return decode_body_fields(self._reader.read(position, {MEMBER_OF[field] for field in self.fields}), self.fields)


class PublishedBodies(Bodies):
    """People in the folder ``5000_body_shapes_and_measures`` that came with GarmentCodeData, as it is.

    >>> ds = PublishedBodies("GarmentCodeData_v2", fields=("measures", "straight"))  # doctest: +SKIP
    >>> ds[ds.names.index("00345")]["straight"].shape  # doctest: +SKIP
    torch.Size([23752, 3])

    ``names``: whom to read; everybody by default. ``segmentation``: GarmentCode's ``ggg_body_segmentation.json``, which
    tells the parts. The sign of ``arm_angle`` is that of the authors' rig, see ``PublishedPeople.shape``.
    Raises ``ShardError`` with the first file that is missing of those that the fields come from, ``BodyError`` for one
    that is not as it should be.
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
        kinds = {"shape": "meta", "arm_angle": "meta", "measures": "measures", "straight": "straight", "apart": "apart"}
        needed = dict.fromkeys(kinds[field] for field in self.fields if field != "name")
        self._people = PublishedPeople(root, names=names, needed=needed, segmentation=segmentation)
        self.names = self._people.names

    @property
    def mesh(self) -> BodyMesh:
        return self._people.mesh

    def __len__(self) -> int:
        return len(self.names)

    def identity(self) -> dict[str, Any]:
        """What tells these people from others: their names."""
        return {"ends": [self.names[0], self.names[-1]], "names": zlib.crc32("\n".join(self.names).encode())}

    def person(self, index: int) -> Person:
        return self._people.person(self.names[self._position(index)])

    def _names(self) -> Sequence[str]:
        return self.names

    def _values(self, position: int) -> Mapping[str, Any]:
        name, wanted = self.names[position], set(self.fields)
        values: dict[str, Any] = {"name": name}
        if wanted & {"shape", "arm_angle"}:
            shape = self._people.shape(name)
            values |= {"shape": shape.weights, "arm_angle": shape.arm_angle}
        if "measures" in wanted:
            values["measures"] = measure_row(self._people.measurements(name))
        return values | {pose: self._people.vertices(name, pose) for pose in POSES if pose in wanted}


def _tensor(value: Any, dtype: torch.dtype | None) -> Tensor:
    """The number or numbers as ``dtype``, or as they are."""
    return tensor_of(np.asarray(value), dtype)
