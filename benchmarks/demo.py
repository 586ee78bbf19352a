"""Demo on the CPU: make garments, read them back with a DataLoader, write a contact sheet.

python -m benchmarks.demo --out demo
"""

import argparse
import logging
import time
from pathlib import Path

import numpy as np
from torch.utils.data import DataLoader
from tqdm import tqdm

from gcd_dataset import Progress, generate
from gcd_dataset.files import write_whole
from gcd_dataset.generator.drawing import contact_sheet, draw_pattern, png_bytes
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders import GarmentDataset, collate_packed
from gcd_dataset.spec import pattern_from_spec

SEED = 4
DESIGNS = 4  # each for the neutral body and a random one
SHORT = Overlay.from_dict(
    {
        "meta": {"bottom": {"options": ["SkirtCircle", "Skirt2", "PencilSkirt", "Pants", "none"]}},
        "sleeve": {"length": {"range": [0.1, 0.5]}},
        "skirt": {"length": {"range": [0.0, 0.3]}},
        "flare-skirt": {"length": {"range": [0.0, 0.3]}},
        "pencil-skirt": {"length": {"range": [0.2, 0.4]}},
        "pants": {"length": {"range": [0.2, 0.4]}},
    }
)
"""Short garments: a CPU drapes them in seconds."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("demo"), help="folder for shards and picture")
    out: Path = parser.parse_args().out
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    start = time.perf_counter()

    config = MakeConfig(bodies="both", resolution=2.0, device="cpu", picture=384, design=SHORT)
    print(f"Making {2 * DESIGNS} garments: {DESIGNS} designs, each for two bodies, draped at 2 cm on the CPU")
    with tqdm(total=2 * DESIGNS, unit="garment") as bar:

        def on_progress(progress: Progress) -> None:
            bar.update(progress.done - bar.n)

        made = generate(out / "garments", 2 * DESIGNS, seed=SEED, config=config, on_progress=on_progress)
    print(", ".join(f"{count} {outcome.lower()}" for outcome, count in made.outcomes.items()) or "all made before")

    dataset = GarmentDataset(out / "garments")
    loader = DataLoader(dataset, batch_size=4, num_workers=0, collate_fn=collate_packed)
    for number, batch in enumerate(loader):
        shapes = ", ".join(f"{name} {tuple(batch[name].shape)}" for name in ("verts", "faces", "points", "panels"))
        print(f"batch {number}: {shapes}")

    rows = []
    for item in (dataset[index] for index in range(len(dataset))):
        pattern = pattern_from_spec(item["spec"], "pattern")
        pictures = [np.asarray(item[view]).transpose(1, 2, 0) for view in ("front", "back")]
        rows += [*pictures, draw_pattern(pattern, size=config.picture)]
    sheet = out / "contact_sheet.png"
    write_whole(sheet, png_bytes(contact_sheet(rows, columns=6)))
    print(f"{time.perf_counter() - start:.0f} s; look at {sheet.resolve()}")


if __name__ == "__main__":
    main()
