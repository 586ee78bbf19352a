"""``MakeConfig``, the options of samples, and the recipe: those options that decide the samples' bytes."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict, get_args

from gcd_dataset import __version__
from gcd_dataset.devicenames import named_devices
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body.motion import GAITS
from gcd_dataset.generator.body.sizes import CHARTS, SizeChart, read_chart
from gcd_dataset.generator.garments.overlay import NO_OVERLAY, Overlay
from gcd_dataset.generator.outfits import OUTFITS, Outfits, WornDesign, read_outfits
from gcd_dataset.options import Option
from gcd_dataset.records import FPS, Measurements, Pose
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.layout import Layout, garments_layout, recipe_hash

Bodies = Literal["neutral", "random", "both", "female", "male", "pooled"]
LastStage = Literal["pattern", "mesh", "drape"]
OnFail = Literal["retry", "keep"]
KINDS = {
    str: "word",
    int: "whole number",
    bool: "true or false",
    float: "number",
    Overlay: "design overlay, by Overlay.from_dict or read_overlay",
}
USUAL_FABRIC = "default"
NO_MISFIT = "0:0"
STEPS = re.compile(r"([+-]?\d{1,3}):([+-]?\d{1,3})")
LATER = {"fabric": USUAL_FABRIC, "bodies_each": 1, "arms": 0.0, "captions": False, "views": 0}
LATER |= {"ease": False, "maps": False, "sizes": "", "misfit": NO_MISFIT, "outfits": "", "poses": ""}
"""Options that a recipe omits at these values, so that the hash of recipes older than they are stays the same."""
FINEST, COARSEST = 0.2, 10.0  # cm
LIMITS = {
    "points": (0, 1 << 20),  # at most 12 MB a sample
    "picture": (0, 4096),  # pixels; at most 50 MB while rendering
    "views": (0, 100),
    "view_size": (16, 4096),  # pixels
    "max_attempts": (1, 10_000),  # 17 of 20 designs are accepted at the first attempt
    "bodies_each": (1, 10_000),
}
MAX_ARM_TURN = 15.0  # degrees; panels are placed round arms in the A-pose


@dataclass(frozen=True, slots=True)
class MakeConfig:
    """The options of samples, besides seed and index. Raises ``ConfigError`` for an invalid value.

    ``gcd_dataset.options.options_of(MakeConfig)`` lists the options with help texts and units.
    """

    bodies: Annotated[
        Bodies,
        Option(
            "wearers; neutral: the mean body; random: women and men, distributed as in a survey; female, male: adults "
            "of one sex; pooled: bodies mostly between the sexes, as in GarmentCodeData; both: samples 2i and 2i+1 are "
            "one design on the neutral body and on a random body"
        ),
    ] = "random"
    bodies_each: Annotated[
        int,
        Option(
            "drawn bodies for each design: with 3, samples 3i, 3i+1 and 3i+2 are one design on three bodies; bodies = "
            "both puts the neutral body before them"
        ),
    ] = 1
    arms: Annotated[
        float,
        Option(
            "largest rotation of both arms, up or down from the A-pose, random for each wearer; measures, design and "
            "pattern are made for the A-pose",
            unit="degrees",
        ),
    ] = 0.0
    stage: Annotated[LastStage, Option("last step to run")] = "drape"
    resolution: Annotated[float, Option("length of the mesh's edges", unit="cm")] = 1.0
    device: Annotated[
        str, Option("device for draping and rendering: cpu, cuda:0, cuda:0,1; auto: all GPUs, or the CPU without a GPU")
    ] = "auto"
    on_fail: Annotated[
        OnFail,
        Option(
            "if a drape does not settle; retry: draw another design for all its bodies; keep: keep the sample with its "
            "outcome, which gcd generate writes into split failed"
        ),
    ] = "retry"
    points: Annotated[int, Option("surface points of a sample")] = 8192
    picture: Annotated[int, Option("width and height of the pictures; 0 for no pictures", unit="pixels")] = 512
    max_attempts: Annotated[
        int,
        Option(
            "designs tried for one index, or for each garment of its outfit; the last one is kept even if its drape "
            "does not settle"
        ),
    ] = 30
    design: Annotated[Overlay, Option("overlay that narrows the design space")] = NO_OVERLAY
    fabric: Annotated[
        str,
        Option(
            "fabric, by its name in drape.FABRICS: denim, drill, wool_light, …; random: another for each sample, drawn "
            "between measured fabrics"
        ),
    ] = USUAL_FABRIC
    captions: Annotated[
        bool, Option("describe each garment in English at three levels of detail, in the member caption.txt")
    ] = False
    ease: Annotated[
        bool, Option("measure girths and lengths of cloth and wearer, as cut and as worn, for fit in meta.json")
    ] = False
    maps: Annotated[
        bool, Option("stretch, gap to the skin and pressure on it, for each vertex, in the member maps.z")
    ] = False
    views: Annotated[
        int,
        Option("pictures of each garment from drawn cameras, in drawn cloth, light and place, besides front and back"),
    ] = 0
    view_size: Annotated[int, Option("width and height of these pictures", unit="pixels")] = 256

    sizes: Annotated[
        str,
        Option(
            "size chart, women, men or a TOML file: each garment is cut for a size of it, and draped on its wearer; "
            "meta.fit names both sizes and how it fits; a body without a size in the chart is drawn again; empty: each "
            "garment is cut for its wearer"
        ),
    ] = ""
    misfit: Annotated[
        str,
        Option(
            "sizes from the wearer's to the one that the garment is cut for, as in --misfit=-3:3, each with equal "
            "probability; a size beyond the ends of the chart is not drawn: where it has none in the range, the nearest"
        ),
    ] = NO_MISFIT
    outfits: Annotated[
        str,
        Option(
            "outfits, everyday or a TOML file: each sample is several garments on one body, draped over each other; "
            "design, sizes and misfit are for single garments; empty: a sample is one garment"
        ),
    ] = ""
    poses: Annotated[
        str,
        Option(
            "pose in which each garment is draped, drawn by seed and number; standing: another for each sample, bones "
            "within 45 degrees of the A-pose; t-pose, … or a JSON or TOML file of poses: one of them; walk, stroll, … "
            "or a BVH or AMASS file: a motion, 30 frames a second, in the member motion.z; measures and pattern are "
            "made for the A-pose; for single garments; empty: the A-pose"
        ),
    ] = ""
    chart: SizeChart | None = field(default=None, init=False, repr=False, compare=False)
    """The chart ``sizes``, as read."""
    wardrobe: Outfits | None = field(default=None, init=False, repr=False, compare=False)
    """The file ``outfits``, as read."""
    given_poses: tuple[Pose, ...] = field(default=(), init=False, repr=False, compare=False)
    """The poses of the file ``poses``; none where they are drawn, or a motion."""
    motion: tuple[Pose, ...] = field(default=(), init=False, repr=False, compare=False)
    """The poses of the motion ``poses``, ``FPS`` a second; none where the body stays."""

    def __post_init__(self) -> None:
        for entry in (entry for entry in fields(self) if entry.init):
            _require_type(entry.name, getattr(self, entry.name), type(entry.default))
        for name, kind in {"bodies": Bodies, "stage": LastStage, "on_fail": OnFail}.items():
            if getattr(self, name) not in get_args(kind):
                raise ConfigError(f"unknown {name} {getattr(self, name)!r}: choose one of {', '.join(get_args(kind))}")
        # As a float, so that 2 and 2.0 give one recipe.
        object.__setattr__(self, "resolution", float(check_resolution(self.resolution)))
        object.__setattr__(self, "arms", float(self.arms))
        if not 0 <= self.arms <= MAX_ARM_TURN:
            raise ConfigError(f"arms is {self.arms}°: give an angle from 0 to {MAX_ARM_TURN}")
        if self.fabric != USUAL_FABRIC:
            _require_fabric(self.fabric)
        for name, (least, most) in LIMITS.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise ConfigError(f"{name} is {value if value < 10**15 else '10**15 or more'}: give {least} to {most}")
        if self.bodies == "neutral" and self.bodies_each > 1:
            raise ConfigError(f"bodies_each is {self.bodies_each}, but there is one neutral body: give 1")
        if not (match := STEPS.fullmatch(self.misfit)) or int(match[1]) > int(match[2]):
            raise ConfigError(f"misfit is {self.misfit!r}: give two whole numbers, the smaller first, such as -3:3")
        # So that -3:3 and -3:+3 give one recipe.
        object.__setattr__(self, "misfit", f"{int(match[1])}:{int(match[2])}")
        if self.sizes:
            object.__setattr__(self, "chart", read_chart(self.sizes))
        elif self.misfit != NO_MISFIT:
            raise ConfigError(f"misfit is {self.misfit}, but there is no size chart: give sizes, such as women")
        if self.outfits:
            if self.sizes or self.design != NO_OVERLAY:
                given = "sizes" if self.sizes else "design"
                raise ConfigError(
                    f"{given} is for single garments: leave it out with outfits, which name their designs"
                )
            object.__setattr__(self, "wardrobe", read_outfits(self.outfits))
        if self.poses:
            poses, motion = self._read_poses()
            object.__setattr__(self, "given_poses", poses)
            object.__setattr__(self, "motion", motion)
        if self.views and self.stage != "drape":
            raise ConfigError(f"views is {self.views}, but stage {self.stage} drapes nothing: give stage drape, or 0")
        if self.maps and self.stage != "drape":
            raise ConfigError(f"maps are of a drape, and stage {self.stage} drapes nothing: give stage drape")
        if self.ease and self.stage == "pattern":
            raise ConfigError("ease is measured on the mesh, and stage pattern makes none: give stage mesh or drape")

    def _read_poses(self) -> tuple[tuple[Pose, ...], tuple[Pose, ...]]:
        """``given_poses`` and ``motion``."""
        from gcd_dataset.generator.body.motion import MOTION_FILES, named_motion
        from gcd_dataset.generator.body.pose import STANDING, read_poses

        if self.stage != "drape":
            raise ConfigError(f"poses are of a drape, and stage {self.stage} drapes nothing: give stage drape")
        if self.outfits:
            raise ConfigError("poses are for single garments: leave poses out with outfits, whose wearers cannot move")
        path = Path(self.poses)
        if self.poses in GAITS or path.suffix.lower() in MOTION_FILES:
            poses = enumerate(named_motion(self.poses, fps=FPS), 1)
            return (), tuple(replace(pose, name=f"{path.stem}, frame {k}") for k, pose in poses)
        return () if self.poses == STANDING else read_poses(self.poses), ()

    @property
    def wearers(self) -> int:
        """Number of bodies that wear one design."""
        return self.bodies_each + (self.bodies == "both")

    @property
    def most_garments(self) -> int:
        """Number of garments of the largest outfit."""
        return self.wardrobe.most if self.wardrobe else 1

    def worn(self, seed: int, number: int, wearers: Sequence[Measurements]) -> tuple[WornDesign, ...]:
        """The garments of design ``number``, from the skin outwards; the same in all attempts."""
        if self.wardrobe is None:
            return (WornDesign(self.design),)
        return self.wardrobe.draw(rng(seed, number, Stage.OUTFIT), wearers)

    @property
    def steps(self) -> tuple[int, int]:
        """Least and most of ``misfit``."""
        least, most = map(int, self.misfit.split(":"))
        return least, most


class MakeOptions(TypedDict, total=False):
    """The options of ``MakeConfig`` as keyword arguments of other functions; all but ``stage`` and ``design``."""

    bodies: Bodies
    bodies_each: int
    arms: float
    resolution: float
    device: str
    on_fail: OnFail
    points: int
    picture: int
    max_attempts: int
    fabric: str
    captions: bool
    ease: bool
    maps: bool
    views: int
    view_size: int
    sizes: str
    misfit: str
    outfits: str
    poses: str


def check_resolution(centimetres: float) -> float:
    """The edge length itself [cm]. Raises ``ConfigError`` unless it is from ``FINEST`` to ``COARSEST``."""
    if not FINEST <= centimetres <= COARSEST:
        raise ConfigError(f"resolution is {centimetres} cm: give a length from {FINEST} to {COARSEST}")
    return centimetres


def recipe_of(config: MakeConfig) -> dict[str, Any]:
    """All options that decide the bytes of a sample besides seed and index, as JSON values."""
    recipe = {entry.name: getattr(config, entry.name) for entry in fields(config) if entry.init}
    recipe["design"] = config.design.to_dict()
    if not config.views:
        del recipe["view_size"]
    if config.chart and config.sizes not in CHARTS:  # its name and content decide, wherever the file lies
        bodies = {size: body.to_file_values() for size, body in config.chart.bodies.items()}
        content = {"name": config.chart.name, "bodies": bodies, "limits": dict(config.chart.limits)}
        recipe["sizes"] = recipe_hash(content)
    if config.wardrobe and config.outfits not in OUTFITS:
        recipe["outfits"] = recipe_hash(dict(config.wardrobe.content))
    if config.given_poses:
        recipe["poses"] = recipe_hash({pose.name: {**pose.turns} for pose in config.given_poses})
    if config.motion and config.poses not in GAITS:  # rounded: machines differ in the last digits
        recipe["poses"] = recipe_hash({pose.name: pose.array.round(6).tolist() for pose in config.motion})
    for name, usual in LATER.items():
        if recipe[name] == usual:
            del recipe[name]
    recipe["device"] = device_kind(config) if config.stage == "drape" else "cpu"
    return recipe


def layout_of_samples(config: MakeConfig) -> Layout:
    """The members of a sample of this config."""
    sides = config.stage == "drape" and config.picture > 0
    return garments_layout(
        caption=config.captions,
        maps=config.maps,
        pose=bool(config.poses),
        motion=bool(config.motion),
        views=config.views,
        sides=sides,
        garments=config.most_garments,
    )


def device_kind(config: MakeConfig) -> str:
    """``cpu`` or ``cuda``. Raises ``ConfigError`` for a malformed name; does not check that the device exists."""
    return devices_of(config)[0].partition(":")[0]


def devices_of(config: MakeConfig) -> tuple[str, ...]:
    """The devices of a config: ``cpu``, or GPUs; ``auto``: all GPUs, or the CPU without any.

    Raises ``ConfigError`` for a malformed name.

    >>> devices_of(MakeConfig(device="cuda:0,2"))
    ('cuda:0', 'cuda:2')
    """
    # Parse only: initialising CUDA here would break forked workers.
    if config.device != "auto":
        return named_devices(config.device)
    from gcd_dataset.generator.drape import every_device

    return every_device()


@cache
def versions() -> dict[str, str]:
    """Versions of this package and the libraries that decide the bytes of a sample."""
    return {"gcd_dataset": __version__} | {name: version(name) for name in ("numpy", "scipy", "shapely", "warp-lang")}


def _require_fabric(name: str) -> None:
    from gcd_dataset.generator.drape import RANDOM_FABRIC, fabric_named

    if name == RANDOM_FABRIC:
        return
    try:
        fabric_named(name)
    except ConfigError as error:
        raise ConfigError(f"{error}, {RANDOM_FABRIC}") from error


def _require_type(name: str, value: object, kind: type) -> None:
    allowed = (int, float) if kind is float else kind
    if not isinstance(value, allowed) or isinstance(value, bool) is not (kind is bool):
        raise ConfigError(f"{name} is {value!r}: give a {KINDS[kind]}")
