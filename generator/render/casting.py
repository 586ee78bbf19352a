"""Rendering of batches: scenes and views in, pictures and truths out; a GPU works in the background."""

from collections.abc import Sequence

from gcd_dataset.generator.render.pictures import MapName, Picture, View
from gcd_dataset.generator.render.scene import Scene

__all__ = ["PendingPictures", "render", "start_pictures"]


def render(
    scenes: Sequence[Scene],
    views: Sequence[View],
    *,
    size: int = 512,
    maps: Sequence[MapName] = (),
    device: str = "auto",
) -> list[Picture]:
    """A picture of ``size`` × ``size`` pixels for each view, in order, with the ``maps`` named.

    Views of one scene share its mesh. A picture is a function of its scene, view and size: the same bytes in any batch
    and order on one class of device. Raises ``ConfigError`` for a missing device, a size below 1, an unknown map or a
    view of a scene that is not there.
    """
    return start_pictures(scenes, views, size=size, maps=maps, device=device).pictures()


def start_pictures(
    scenes: Sequence[Scene], views: Sequence[View], *, size: int, maps: Sequence[MapName] = (), device: str = "auto"
) -> "PendingPictures":
    """Start ``render``; a GPU works in the background."""
    raise NotImplementedError


class PendingPictures:
    """Pictures that a device is rendering."""

    def ready(self) -> bool:
        """Whether ``pictures`` returns without waiting."""
        raise NotImplementedError

    def pictures(self) -> list[Picture]:
        """Wait for the pictures. Call once: this releases the buffers."""
        raise NotImplementedError
