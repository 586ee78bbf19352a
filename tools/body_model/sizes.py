"""Makes the size charts ``generator/data/sizes_women.toml`` and ``sizes_men.toml`` from drawn adults.

    python -m tools.body_model.sizes generator/data

Takes three minutes of one core. Sizes are 4 cm apart in bust, waist and hips, about the mean of the adults in whole
centimetres: waist and hips are those of the adults with the bust of the middle size. The other measures are their
linear regression on bust, waist and hips.
"""

import argparse
from pathlib import Path

import numpy as np

from gcd_dataset.files import write_whole
from gcd_dataset.generator.body.by_name import make_person
from gcd_dataset.generator.body.shape import SEXES
from gcd_dataset.generator.body.sizes import CHARTS
from gcd_dataset.measurements import MEASURES

PEOPLE = 2000
STEP = 4  # cm, in each of ``DECIDING``
DECIDING = ("bust", "waist", "hips")
SIZES = range(-5, 7)  # steps from the middle size


def main() -> None:
    """Write both charts into a folder."""
    parser = argparse.ArgumentParser(description="make the size charts")
    parser.add_argument("folder", type=Path, help="folder for sizes_women.toml and sizes_men.toml")
    folder = parser.parse_args().folder
    for sex, chart in zip(SEXES, CHARTS, strict=True):
        people = [make_person(0, index, bodies=sex).measurements.to_file_values() for index in range(PEOPLE)]
        text = chart_text(np.array([[person[name] for name in MEASURES] for person in people]))
        write_whole(folder / f"sizes_{chart}.toml", text.encode())


def chart_text(people: np.ndarray) -> str:
    """The chart as TOML. ``people``: a row for each person, a column for each measure [cm, degrees]."""
    deciding = people[:, [MEASURES.index(name) for name in DECIDING]]
    bust = STEP * round(float(deciding[:, 0].mean()) / STEP)
    at_bust = np.polyval(np.polyfit(deciding[:, 0], deciding, 1), bust)
    middle = np.rint(at_bust).astype(int)
    design = np.column_stack([np.ones(len(people)), deciding])
    slopes = np.linalg.lstsq(design, people, rcond=None)[0]
    lines = ["# Made by tools/body_model/sizes.py [cm, degrees]."]
    for step in SIZES:
        girths = middle + STEP * step
        fits = (
            f"{name} = [{girth - STEP // 2}, {girth + STEP // 2}]" for name, girth in zip(DECIDING, girths, strict=True)
        )
        body = dict(zip(MEASURES, np.array([1, *girths]) @ slopes, strict=True))
        lines += ["", f"[sizes.{girths[0]}]", f"fits = {{ {', '.join(fits)} }}", f"[sizes.{girths[0]}.body]"]
        lines += [f"{name} = {value:.1f}" for name, value in body.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
