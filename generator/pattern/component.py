"""Components: pieces sewn to each other, with named interfaces to other components."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern.piece import Interface, Join, Piece, Section, Vector
from gcd_dataset.records import Closure, EdgeRole, PanelRole


@dataclass(frozen=True)
class Component:
    """A part of a garment. All methods return a new component."""

    pieces: tuple[Piece, ...]
    joins: tuple[Join, ...] = ()
    interfaces: Mapping[str, Interface] = field(default_factory=dict)

    @classmethod
    def of(cls, *parts: "Piece | Component") -> Self:
        """Pieces and components put together with their seams, but without the interfaces.

        Raises ``PatternError`` for two pieces of the same name.
        """
        components = [part if isinstance(part, Component) else Component((part,)) for part in parts]
        pieces = tuple(piece for part in components for piece in part.pieces)
        names = [piece.name for piece in pieces]
        if twice := {name for name in names if names.count(name) > 1}:
            raise PatternError(
                f"panels {', '.join(sorted(twice))} appear twice in one component: give each panel its own name"
            )
        return cls(pieces, tuple(join for part in components for join in part.joins))

    def sewn(
        self,
        left: Interface,
        right: Interface,
        *,
        gathered: bool = False,
        closure: Closure = Closure.SEWN,
        closed: tuple[float, float] = (0.0, 1.0),
    ) -> Self:
        """With one more join, of interfaces walked in the same direction; keywords: see ``Join``."""
        return replace(self, joins=(*self.joins, Join(left, right, gathered, closure, closed)))

    def offering(self, **interfaces: Interface) -> Self:
        """With named interfaces to other components."""
        return type(self)(self.pieces, self.joins, {**self.interfaces, **interfaces})

    def interface(self, name: str) -> Interface:
        """The interface of that name. Raises ``PatternError`` with the known names."""
        if name not in self.interfaces:
            raise PatternError(f"no interface named {name}: there are {', '.join(self.interfaces)}")
        return self.interfaces[name]

    def piece(self, name: str) -> Piece:
        """The piece of that name. Raises ``PatternError`` with the known names."""
        for piece in self.pieces:
            if piece.name == name:
                return piece
        raise PatternError(f"no panel named {name}: there are {', '.join(piece.name for piece in self.pieces)}")

    def with_piece(self, piece: Piece) -> Self:
        """With another piece in place of the one of the same name."""
        return replace(self, pieces=tuple(piece if own.name == piece.name else own for own in self.pieces))

    def moved(self, by: Vector) -> Self:
        """Shifted in space [cm]."""
        return replace(self, pieces=tuple(piece.moved(by) for piece in self.pieces))

    def turned(self, angle: float) -> Self:
        """Turned about the z axis through the world's origin [rad]."""
        return replace(self, pieces=tuple(piece.turned(angle) for piece in self.pieces))

    def labelled(self, label: PanelRole) -> Self:
        """With this label on every piece without one."""
        return replace(self, pieces=tuple(p if p.label else p.labelled(label) for p in self.pieces))

    def with_edge_label(self, interface: Interface, label: EdgeRole) -> Self:
        """With a label on the edges of an interface; every part of a divided edge keeps it."""
        edges = {(section.panel, section.edge) for section in interface}
        return replace(self, pieces=tuple(_labelled(piece, edges, label) for piece in self.pieces))

    def mirrored(self, old: str, new: str) -> Self:
        """The mirror image about x = 0, with ``old`` replaced by ``new`` in the names of panels.

        >>> from gcd_dataset.generator.pattern.outline import Outline
        >>> sleeve = Piece("right_sleeve", Outline.start(0, 0).line(10, 0).line(10, 20).close()).at(-30, 120, 0)
        >>> left = Component.of(sleeve).mirrored("right", "left")
        >>> left.piece("left_sleeve").translation
        (30, 120, 0)
        """
        return replace(
            self,
            pieces=tuple(_with_mirrored_labels(p.mirrored(p.name.replace(old, new))) for p in self.pieces),
            joins=tuple(
                replace(join, left=_renamed(join.left, old, new), right=_renamed(join.right, old, new))
                for join in self.joins
            ),
            interfaces={name: _renamed(interface, old, new) for name, interface in self.interfaces.items()},
        )

    def length(self, interface: str) -> float:
        """Length of an interface along the cloth, its gathers included [cm]."""
        return sum(self.piece(s.panel).length(s.edge) for s in self.interface(interface))

    def points(self, interface: str | None = None) -> Float[np.ndarray, "n 3"]:
        """Points along all outlines, or along one interface, in space [cm]."""
        if interface is None:
            return np.concatenate([piece.points() for piece in self.pieces])
        return np.concatenate([self.piece(s.panel).points(s.edge) for s in self.interface(interface)])

    def _bounds(self, interface: str | None = None) -> tuple[Vector, Vector]:
        """Lowest and highest corner of the bounding box of ``points`` [cm]."""
        if interface is None:
            bounds = [piece.bounds() for piece in self.pieces]
        else:
            bounds = [self.piece(section.panel).bounds(section.edge) for section in self.interface(interface)]
        lows, highs = zip(*bounds, strict=True)
        (x0, y0, z0), (x1, y1, z1) = map(min, zip(*lows, strict=True)), map(max, zip(*highs, strict=True))
        return (x0, y0, z0), (x1, y1, z1)

    def placed_by(
        self, interface: str, other: "Component", other_interface: str, *, gap: float, top: bool = False
    ) -> Self:
        """Moved so that its interface lies at the interface of another component, with a gap between them [cm].

        Aligns the centres of the interfaces' bounding boxes, or with ``top`` the centres of their upper sides. The gap
        points from the component's interface to its centre, so that a positive gap moves the components apart.
        Raises ``PatternError`` if centre and interface coincide, which leaves the direction undefined.
        """
        edge = self._bounds(interface)
        start, target = _centre(edge, top), _centre(other._bounds(other_interface), top)
        away = _centre(edge, False) - _centre(self._bounds(), False)
        distance = float(np.linalg.norm(away))
        if distance == 0.0:
            raise PatternError(
                f"interface {interface} lies in the middle of its component, so the direction of the gap is undefined"
            )
        shift = target - (start + gap / distance * away)
        return self.moved((float(shift[0]), float(shift[1]), float(shift[2])))


def _centre(bounds: tuple[Vector, Vector], top: bool) -> Float[np.ndarray, "3"]:
    """Centre of a bounding box, or of its upper side."""
    low, high = np.array(bounds)
    centre = 0.5 * (low + high)
    if top:
        centre[1] = high[1]
    return centre


def _renamed(interface: Interface, old: str, new: str) -> Interface:
    return tuple(Section(s.panel.replace(old, new), s.edge, s.backward, s.ruffle) for s in interface)


def _with_mirrored_labels(piece: Piece) -> Piece:
    if not any(stroke.label for stroke in piece.outline.strokes):
        return piece
    labels = (s.label.mirrored if isinstance(s.label, EdgeRole) else s.label for s in piece.outline.strokes)
    return replace(piece, outline=piece.outline.labelled(labels))


def _labelled(piece: Piece, edges: set[tuple[str, str]], label: EdgeRole) -> Piece:
    if not any((piece.name, stroke.name) in edges for stroke in piece.outline.strokes):
        return piece
    labels = (label if (piece.name, stroke.name) in edges else stroke.label for stroke in piece.outline.strokes)
    return replace(piece, outline=piece.outline.labelled(labels))
