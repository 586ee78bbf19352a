"""Finds the columns of an HDF5 file: ``python hdf5_layout.py FILE CPU_SECONDS``, with their names as JSON on stdin.

libhdf5 hangs on some damaged files, and allocates without bound for others. Therefore only this program, a child
process with limits on time and memory, calls it for reading. It prints one JSON object: ``attributes``, and
``columns``, each with ``type`` (NumPy's, or ``text``), ``shape`` and ``offset`` [bytes] in the file; or ``problem``, a
sentence. It reads no sample, so a large file takes as long as a small one.
"""

import json
import resource
import sys
from typing import Any

import h5py

__all__: list[str] = []

MEMORY = 1 << 31  # bytes of address space, of which h5py and its libraries take a quarter
NUMBERS = "biuf"  # dtype.kind
ADDRESS = 8  # bytes of an address in the file, and of a length


def main(path: str, seconds: int) -> None:
    """Print attributes and columns of the file as JSON."""
    names = json.load(sys.stdin)
    _limit(seconds)
    try:
        with h5py.File(path, "r", locking=False) as file:
            layout = _layout(file, names["attributes"], names["columns"])
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        layout = {"problem": " ".join(str(error).split()) or type(error).__name__}
    print(json.dumps(layout))


def _limit(seconds: int) -> None:
    """Set this process's limits on CPU time and address space."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    used = int(usage.ru_utime + usage.ru_stime) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (used + seconds, used + seconds))
    if sys.platform == "linux":  # other kernels lack this limit
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def _layout(file: h5py.File, attributes: list[str], columns: list[str]) -> dict[str, Any]:
    if file.id.get_create_plist().get_sizes() != (ADDRESS, ADDRESS):
        raise ValueError(f"its addresses are not of {ADDRESS} bytes")
    return {
        "attributes": {name: _plain(file.attrs[name]) for name in attributes if name in file.attrs},
        "columns": {name: _column(file[name], name) for name in columns if _is_inside(file, name)},
    }


def _plain(value: Any) -> Any:
    """A number or text; ``None`` for anything else."""
    value = value.item() if hasattr(value, "item") and getattr(value, "shape", None) == () else value
    return value if isinstance(value, int | float | str) else None


def _is_inside(file: h5py.File, name: str) -> bool:
    """Whether the file has the name. Raises ``ValueError`` for a link to another file or name."""
    parts = name.split("/")
    for end in range(1, len(parts) + 1):
        link = file.get("/".join(parts[:end]), getlink=True)
        if link is None:
            return False
        if not isinstance(link, h5py.HardLink):
            raise ValueError(f"{name} is a link")
    return True


def _column(column: Any, name: str) -> dict[str, Any]:
    """Type, shape and offset. Raises ``ValueError`` unless the column is contiguous in this file."""
    if not isinstance(column, h5py.Dataset):
        raise ValueError(f"{name} is a group")
    properties = column.id.get_create_plist()
    if properties.get_layout() != h5py.h5d.CONTIGUOUS or properties.get_external_count():
        raise ValueError(f"{name} is not contiguous in this file")
    text = h5py.check_string_dtype(column.dtype)
    if not (column.dtype.kind in NUMBERS if text is None else text.length is None) or column.shape is None:
        raise ValueError(f"{name} holds neither numbers nor texts")
    offset = column.id.get_offset() if column.size else 0
    if offset is None:
        raise ValueError(f"{name} was never written")
    return {"type": "text" if text else column.dtype.str, "shape": column.shape, "offset": offset}


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
