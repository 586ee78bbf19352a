"""Output of ``gcd measure``: a measurement file with comments on landmarks and uncertain measures."""

from pathlib import Path

from gcd_dataset.bodyfiles import measurements_text
from gcd_dataset.errors import shown
from gcd_dataset.generator.body import build_body
from gcd_dataset.generator.body.by_name import shape_by_name
from gcd_dataset.generator.body.measuring import measure_closely
from gcd_dataset.generator.body.mesh_bodies import measure_file
from gcd_dataset.generator.body.tailor import MeasureResult


def measured_text(
    body: str, landmarks: Path | None = None, segmentation: Path | None = None, height: float | None = None
) -> str:
    """The measures of a mesh file, or of a generated body given by name, as commented YAML; errors: see ``named_body``.

    Generated bodies are measured in the A-pose with the legs straight. ``height`` [cm] gives the scale of a mesh file.
    """
    shape = shape_by_name(body, legs_apart=False)
    if shape is None:
        taken, remarks = measure_file(body, landmarks, segmentation, height=height)
    else:
        taken, remarks = (
            measure_closely(build_body(shape, name=body)),
            ["mesh of the body model: landmarks known by vertex"],
        )
    comments = [f"measures of {shown(body)} [cm, degrees]", *remarks, *_border_remarks(taken)]
    return "".join(f"# {comment}\n" for comment in comments) + measurements_text(taken.measurements)


def _border_remarks(taken: MeasureResult) -> list[str]:
    """One line for each girth that was measured at the end of its search range."""
    return [
        f"{girth}: measured at height {taken.levels[girth]:.1f} cm, {abs(by):.1f} cm {'above' if by > 0 else 'below'} "
        f"its landmark, {'where the legs part' if girth == 'leg_circ' else 'the end of the search range'}"
        for girth, by in taken.at_border.items()
    ]
