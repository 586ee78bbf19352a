"""Inputs for readers of files: damaged bytes, edited documents, and valid files in amounts that no garment has."""

import json
import math
import random
import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

MOST_EDITS = 3
EXTREME_INTEGERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1)
EXTREME_TEXTS = (
    b"-1", b"0", b"1e400", b"-1e400", b"NaN", b"1e-320", b"9" * 25, b"9" * 5000, b"null", b'""', b"[]", b"{}", b"true",
    b"[" * 3000, b'"../../x"', b'"\\u0000"', b"'a'",
)  # fmt: skip
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
EDITS = (
    "flip",
    "flip",
    "overwrite",
    "delete",
    "repeat",
    "move",
    "zero",
    "truncate",
    "noise",
    "integer",
    "number",
    "number",
)


def mutated(content: bytes, chance: random.Random) -> bytes:
    """The content after one to three random edits: bits, ranges, integers and numbers in text."""
    for _ in range(chance.randint(1, MOST_EDITS)):
        content = _mutation(content, chance.choice(EDITS), chance)
    return content


def _mutation(content: bytes, kind: str, chance: random.Random) -> bytes:
    start, longest = chance.randint(0, len(content)), chance.choice((4, 64, 1024, len(content)))
    end = min(len(content), start + chance.randint(1, max(longest, 1)))
    before, part, after = content[:start], content[start:end], content[end:]
    match kind:
        case "flip" if part:
            return before + bytes([part[0] ^ 1 << chance.randrange(8)]) + part[1:] + after
        case "overwrite" if part:
            return before + chance.randbytes(1) + part[1:] + after
        case "delete":
            return before + after
        case "repeat":
            return before + part + part + after
        case "move":
            at = chance.randint(0, len(before + after))
            return (before + after)[:at] + part + (before + after)[at:]
        case "zero":
            return before + bytes(len(part)) + after
        case "truncate":
            return before
        case "noise":
            return before + chance.randbytes(chance.randint(1, 16)) + part + after
        case "integer":  # binary, of 1 to 8 bytes, as if a size or offset in a header were wrong
            size, order = chance.choice((1, 2, 4, 8)), chance.choice("<>")
            number = struct.pack(
                order + {1: "B", 2: "H", 4: "I", 8: "Q"}[size], chance.choice(EXTREME_INTEGERS) % 2 ** (8 * size)
            )
            return before + number + content[start + size :]
        case "number":  # written as text, in JSON, YAML, OBJ and tar headers
            found = NUMBER.search(content, start) or NUMBER.search(content)
            if found is not None:
                return content[: found.start()] + chance.choice(EXTREME_TEXTS) + content[found.end() :]
    return content


# ----------------------------------------------------------------------------------------------------------- documents

DEEP = 3000  # levels: more than any parser of the standard library recurses
WORDS = ("", "..", "../../x", "/x", "\0", "a\nb", "NaN", "1e999", "right_wrong", "ф" * 300, "\ud800", "é\u202e")
NUMBERS = (
    *(-3, -1, 0, 1, 2, 3, -(2**70), 2**31, 2**63, 2**70, 10**30),
    *(0.5, -0.0, 5e-324, 1.8e308, 1e-9, -7.25, math.nan, math.inf, -math.inf),
)
CHANGES = ("replace", "replace", "replace", "remove", "repeat", "wrap", "rename")


class _Raw:
    """Text inserted into the document unquoted."""

    def __init__(self, text: str) -> None:
        self.text = text


RAW = (_Raw("9" * 5000), _Raw("[" * DEEP + "]" * DEEP), _Raw('{"a":' * DEEP + "1" + "}" * DEEP), _Raw("1e400"))


def edited(document: Any, chance: random.Random) -> bytes:
    """The document as JSON with one to three of its branches replaced, removed, repeated, wrapped or renamed."""
    for _ in range(chance.randint(1, MOST_EDITS)):
        kind = chance.choice(CHANGES)
        new = chance.choice(WORDS) if kind == "rename" else _value(chance)
        document = _changed(document, chance.choice(list(_places(document))), kind, new)
    return json_bytes(document)


def _value(chance: random.Random) -> Any:
    scalars = [chance.choice((None, True, False, *NUMBERS, *WORDS)) for _ in range(chance.randint(1, 4))]
    return chance.choice((scalars[0], scalars[0], scalars, dict(zip(WORDS, scalars, strict=False)), chance.choice(RAW)))


def _places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The paths of all branches, the root first."""
    yield path
    branches = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in branches:
        yield from _places(inner, (*path, key))


def _changed(value: Any, path: tuple[Any, ...], kind: str, new: Any) -> Any:
    if not path:
        return {"replace": new, "wrap": [value]}.get(kind, value)
    key, rest = path[0], path[1:]
    copy = dict(value) if isinstance(value, dict) else list(value)
    if rest or kind in ("replace", "wrap"):
        copy[key] = _changed(copy[key], rest, kind, new)
    elif kind == "remove":
        del copy[key]
    elif kind == "repeat" and isinstance(copy, list):
        copy.insert(key, copy[key])
    elif kind == "rename" and isinstance(copy, dict):
        copy[new] = copy.pop(key)
    return copy


def json_bytes(document: Any) -> bytes:
    """The document as JSON, with numbers and nesting that other JSON writers produce."""
    return _text(document).encode("utf-8", "surrogatepass")


def _text(value: Any) -> str:
    if isinstance(value, _Raw):
        return value.text
    if isinstance(value, dict):
        return "{" + ",".join(f"{json.dumps(str(key))}:{_text(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ",".join(map(_text, value)) + "]"
    return json.dumps(value, default=str)


# ----------------------------------------------------------------------------------------------------------- expensive

Writer = Callable[[bytes, random.Random], bytes]
"""Makes an input from the reader's own file."""


def expensive(name: str, content: bytes, chance: random.Random) -> bytes:
    """An expensive input of a reader of ``EXPENSIVE``; ``content``: its own file."""
    return chance.choice(EXPENSIVE[name])(content, chance)


def _amount(chance: random.Random, most: int) -> int:
    return chance.choice((most, most, most // 8, most // 64))


def _json_bomb(chance: random.Random) -> str:
    n = _amount(chance, 60_000)
    return chance.choice(
        (
            "{" + "".join(f'"k{i}":0,' for i in range(n)) + '"z":0,"z":1}',
            "{" + "".join(f'"k{i}":0,' for i in range(n)) + '"z":0}',
            "[" + "[" * 58 + ",".join("[]" for _ in range(n)) + "]" * 58 + "]",
            "[" + ",".join(["1"] * n) + "]",
            "[" + ",".join(["9" * 4000] * (n // 1000)) + "]",
            "[" + ",".join([f"0.{'0' * 500}1"] * (n // 100)) + "]",
            "1." + "0" * n,
            "1e" + "9" * n,
            '"' + "\\u0041" * n + '"',
            '"' + "x" * 20 * n + '"',
            '{"' + "x" * 20 * n + '":1}',
            '["' + '","'.join(f"name {i}" for i in range(n)) + '"]',
            "[" + ",".join(["null"] * n) + "]",
            " " * 20 * n + "1",
        )
    )


def _bombed_json(content: bytes, chance: random.Random) -> bytes:
    """The document with one of its branches replaced by much JSON."""
    document = json.loads(content)
    return json_bytes(_changed(document, chance.choice(list(_places(document))), "replace", _Raw(_json_bomb(chance))))


def _bombed_yaml(content: bytes, chance: random.Random) -> bytes:
    """YAML of the same top level with a costly branch: JSON, aliases, merge keys, keys repeated at the end."""
    n, top = _amount(chance, 20_000), chance.choice(("body", "design", "v", "sim"))
    levels = "a0: &a0 {x: [1, 2]}\n" + "".join(f"a{i}: &a{i} {{x: *a{i - 1}, y: *a{i - 1}}}\n" for i in range(1, 40))
    merged = "a0: &a0 {x0: 1}\n" + "".join(
        f"a{i}: &a{i} {{x{i}: 1, <<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 12)
    )
    return chance.choice(
        (
            f"{top}: {_json_bomb(chance)}\n",
            f"{top}:\n" + "".join(f"  k{i}: 0\n" for i in range(n)) + "  z: 0\n  z: 1\n",
            f"{levels}{top}: {{meta: {{upper: {{v: *a39}}}}, height: *a39}}\n",
            f"{merged}{top}: *a11\n",
            "".join(f"a{i}: &a{i} [{f'*a{i - 1}' if i else 1}]\n" for i in range(n // 10))
            + f"{top}: *a{n // 10 - 1}\n",
            f"{top}: &a {{x: *a, meta: *a}}\n",
            f"{top}: {{height: {'1:' * n}1}}\n",
            f"{top}: {{height: {'0' * n}7}}\n",
            f"{top}: {{height: 1{'_0' * n}}}\n",
            f"{top}: !!binary {'QUJD' * n}\n",
            f"{top}: {{height: '" + "''" * n + "'}\n",
            f"{top}:\n" + "".join(f"  - {i}\n" for i in range(n)),
            f"{top}: {'[' * 60}{'1,' * n}{']' * 60}\n",
            "".join(f"--- {i}\n" for i in range(n)),
            "#" * 40 * n + f"\n{top}: 1\n",
        )
    ).encode()


def _bombed_toml(content: bytes, chance: random.Random) -> bytes:
    n = _amount(chance, 40_000)
    return (
        content
        + chance.choice(
            (
                ".".join(["a"] * n) + " = 1\n",
                "[" + ".".join(["b"] * n) + "]\n",
                "".join(f"[a.b.c.d{i}]\n" for i in range(n)),
                "[[a]]\n" * n,
                "".join(f"k{i} = {i}\n" for i in range(n)),
                f"a = {'[' * 90}{'1,' * n}{']' * 90}\n",
                f"a = {'{a=' * 90}1{'}' * 90}\n",
                "a = [" + "{}," * n + "]\n",
                'a = "' + "\\u0041" * n + '"\n',
                "a = '''" + "x\n" * n + "'''\n",
                f"a = 0x{'f' * n}\n",
                f"a = {'9' * n}.0\n",
                ("a" * 100 + ".b" * 900 + "\n") * (n // 1000),
                "".join(f"a{i}.b.c.d.e.f.g = 1\n" for i in range(n // 4)),
                f"[design.{'x' * n}]\na = 1\n",
            )
        ).encode()
    )


# ------------------------------------------------------------------------------------------------------- specifications


def _spec(panels: Mapping[str, Any], stitches: Sequence[Any] = (), **properties: Any) -> bytes:
    body = {"panels": panels, "stitches": list(stitches)}
    return json.dumps({"pattern": body, "properties": {"units_in_meter": 100, **properties}}).encode()


def _panel(corners: Sequence[Sequence[float]], curvature: Any = None, x: float = 0.0) -> dict[str, Any]:
    n = len(corners)
    edges = [{"endpoints": [i, (i + 1) % n], "curvature": curvature} for i in range(n)]
    return {"translation": [x, 100, 20], "rotation": [0, 0, 0], "vertices": corners, "edges": edges}


def _square(size: float = 40.0) -> list[list[float]]:
    return [[0, 0], [size, 0], [size, size], [0, size]]


def _ring(n: int, radius: float, *, step: int = 1, inner: float = 1.0) -> list[list[float]]:
    """Corners on a circle; with a ``step``, a star that crosses itself; every second corner at ``inner`` radii."""
    angles = [2 * math.pi * i * step / n for i in range(n)]
    radii = [radius * (inner if i % 2 else 1.0) for i in range(n)]
    return [[r * math.cos(a), r * math.sin(a)] for r, a in zip(radii, angles, strict=True)]


def _costly_pattern(content: bytes, chance: random.Random) -> bytes:
    """A specification with many or large parts."""
    n, big = _amount(chance, 1999), _amount(chance, 40_000)
    name, far = "x" * big, chance.choice((1e3, 1e6, 1e11))
    wild = chance.choice(
        (
            {"type": "quadratic", "params": [[0.5, far]]},
            {"type": "cubic", "params": [[far, far], [-far, far]]},
            {"type": "circle", "params": [far, 1, 1]},
            {"type": "circle", "params": [20.001, 1, 0]},
            {"type": "cubic", "params": [[12.0, 9.0], [-11.0, 9.0]]},
        )
    )
    between = [[{"panel": "p0", "edge": 0}, {"panel": "p0", "edge": 1}]]
    row = {f"p{i}": _panel(_square(), x=i) for i in range(min(n, 500))}
    chain = [[{"panel": f"p{i}", "edge": 1}, {"panel": f"p{i + 1}", "edge": 3}] for i in range(len(row) - 1)]
    many = chance.choice((3, 100, 500))
    return chance.choice(
        (
            lambda: _spec(row, chain),
            lambda: _spec({f"p{i}": _panel(_square(), x=i) for i in range(n)}, chain),
            lambda: _spec({f"p{i}": _panel(_ring(n, 300), x=i) for i in range(many)}),
            lambda: _spec({"p0": _panel(_ring(n, 40))}, between * big),
            lambda: _spec({"p0": _panel(_square())}, between * big),
            lambda: _spec({"p0": _panel(_square())}, [[{"panel": name, "edge": 0}, {"panel": "q", "edge": 0}]] * 50),
            lambda: _spec({"p0": _panel(_ring(n | 1, 300, step=(n | 1) // 2))}),
            lambda: _spec({f"p{i}": _panel(_ring(n | 1, 300, step=(n | 1) // 2)) for i in range(many // 50 + 1)}),
            lambda: _spec({"p0": _panel(_ring(n // 2 * 2 + 4, 450, inner=0.02))}),
            lambda: _spec({"p0": _panel(_square(), wild)}),
            lambda: _spec({f"p{i}": _panel(_square(), wild, x=i) for i in range(many)}),
            lambda: _spec({"p0": _panel(_ring(n, 300), {"type": "cubic", "params": [[0.2, 30.0], [0.8, -30.0]]})}),
            lambda: _spec({f"p{i}": _panel(_square(990), x=i) for i in range(many)}),
            lambda: _spec({"p0": _panel([[0, 0], [990, 0], [990, 0.001], [0, 0.001]])}),
            lambda: _spec({f"p{i}": _panel([[0, 0], [990, 0], [990, 0.02], [0, 0.02]], x=i) for i in range(many)}),
            lambda: _spec({"p0": _panel(_square()) | {"vertices": _square() + [[1, 1]] * big}}),
            lambda: _spec({name: _panel(_square()), name + "y": _panel(_ring(n | 1, 9, step=2))}),
            lambda: _spec({"p0": _panel(_square(9e-7))}, units_in_meter=1e-6),
            lambda: _spec({"p0": _panel(_square(4e5))}, units_in_meter=1e6),
        )
    )()


# --------------------------------------------------------------------------------------------------------------- meshes


def _costly_obj(content: bytes, chance: random.Random) -> bytes:
    n = _amount(chance, 100_000)
    grid = "".join(f"v {i % 300} {i // 300} 0\n" for i in range(n))
    return chance.choice(
        (
            lambda: grid + "f " + " ".join(str(i + 1) for i in range(n)) + "\n",
            lambda: grid + "f 1 2 3\n" * n,
            lambda: grid + "".join(f"f {i}//{i} {i + 1}//{i} {i + 2}//{i}\n" for i in range(1, n - 1)),
            lambda: grid + "f " + " ".join(["1 2 3"] * n) + "\n",
            lambda: "v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "".join(f"g {i}\nf 1 2 3\n" for i in range(n)),
            lambda: "v " + "0 " * 10 * n + "\nf 1 1 1\n",
            lambda: "v 0 0 0\n" + "f 1/" + "1/" * n + " 1 1\n",
            lambda: "v 0 0 0\nf \\\n" + "1 \\\n" * n + "1\n",
            lambda: "v 1e" + "9" * n + " 0 0\nf 1 1 1\n",
            lambda: "".join(f"v {i} 0 0\nf -1 -2 -3\n" for i in range(n)),
            lambda: "\n" * 20 * n + "v 0 0 0\nf 1 1 1\n",
        )
    )().encode()


def _costly_ply(content: bytes, chance: random.Random) -> bytes:
    n, count = _amount(chance, 100_000), chance.choice((1, 10**6, 4_000_000_000, 10**18, -1))
    points = "property float x\nproperty float y\nproperty float z\n"
    three = "end_header\n0 0 0\n1 0 0\n0 1 0\n"
    faces = "property list uchar int vertex_indices\n"
    form = chance.choice(("ascii", "binary_little_endian"))
    return chance.choice(
        (
            f"ply\nformat {form} 1.0\nelement vertex {count}\n{points}element face {count}\n{faces}end_header\n0 0 0\n",
            f"ply\nformat {form} 1.0\n" + "comment x\n" * n + f"element vertex 1\n{points}end_header\n0 0 0\n",
            f"ply\nformat {form} 1.0\nelement vertex 1\n" + f"{points}" * (n // 10) + "end_header\n" + "0 " * n,
            f"ply\nformat {form} 1.0\n"
            + "".join(f"element e{i} {count}\n{faces}" for i in range(n // 10))
            + "end_header\n",
            f"ply\nformat ascii 1.0\nelement vertex {n}\n{points}element face 1\n{faces}end_header\n"
            + "0 0 0\n" * n
            + f"{n} "
            + " ".join(map(str, range(n))),
            f"ply\nformat ascii 1.0\nelement vertex 3\n{points}element face {n}\n{faces}{three}" + "3 0 1 2\n" * n,
            f"ply\nformat ascii 1.0\nelement vertex 3\n{points}element face {n}\n{faces}{three}"
            + "".join(f"{3 + i % 60}{' 0' * (3 + i % 60)}\n" for i in range(n // 10)),
        )
    ).encode()


def _costly_stl(content: bytes, chance: random.Random) -> bytes:
    n, count = _amount(chance, 60_000), chance.choice((0, 1, 10**6, 4_000_000_000))
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 {i} 0\nendloop\nendfacet\n"
    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    return chance.choice(
        (
            lambda: bytes(80) + struct.pack("<I", count) + triangle,
            lambda: bytes(80) + struct.pack("<I", n) + triangle * n,
            lambda: b"solid x\n" + "".join(facet.format(i=i) for i in range(n // 4)).encode() + b"endsolid\n",
            lambda: b"solid " + b"x" * 20 * n + facet.encode() + b"endsolid\n",
            lambda: b"solid x\n" + b"endsolid\nsolid x\n" * n,
            lambda: b"solid x\nfacet normal" + b" 0" * 20 * n + b"\n",
            lambda: b"solid x\n" + b"\n" * 20 * n + facet.format(i=1).encode(),
        )
    )()


# -------------------------------------------------------------------------------------------------------------- readers


EXPENSIVE: Mapping[str, Sequence[Writer]] = {
    "specification": (_costly_pattern, _costly_pattern, _bombed_json),
    "specification-mesh": (_costly_pattern,),
    "release-specification": (_costly_pattern, _bombed_json),
    **dict.fromkeys(("body-parts", "landmarks", "loader-state", "release-split", "viewer-design"), (_bombed_json,)),
    "measurements": (_bombed_yaml,),
    **dict.fromkeys(
        ("design", "release-design", "release-measures", "release-labels", "release-properties"), (_bombed_yaml,)
    ),
    "config": (_bombed_toml,),
    "body-obj": (_costly_obj,),
    "body-ply": (_costly_ply,),
    "body-stl": (_costly_stl,),
}
"""Reader to the writers of its expensive inputs."""
