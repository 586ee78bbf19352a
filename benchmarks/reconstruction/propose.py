"""Designs and wearers that a network proposes for scans or pictures, for ``gcd reconstruct --proposals``.

    python -m benchmarks.reconstruction.propose scans/*.ply --out proposed
    gcd reconstruct scans/*.ply --proposals proposed --out found

``weights/T1.json`` names the network, its sizes and the hash of ``weights/T1.pt``; weights of ``picture_parameters``
propose for folders of pictures, which need no cameras. For each scan, the likeliest design comes first; the choices of
the others, such as the kind of a sleeve, are drawn with the chances that the network gives them.
"""

import argparse
import hashlib
import sys
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
import torch

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.design_codes import decode_design
from benchmarks.reconstruction.design_net import size_of
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.models.parameters import ParameterNet
from benchmarks.reconstruction.models.picture_parameters import PictureParameters
from benchmarks.reconstruction.panel_targets import scaled_points
from benchmarks.reconstruction.weights import load_weights
from gcd_dataset.bodyfiles import write_measurements
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import make_folder
from gcd_dataset.generator.device import resolve_device
from gcd_dataset.generator.garments.design import write_design
from gcd_dataset.jsonfile import JsonPath, read_json
from gcd_dataset.scoring.distances import read_points
from gcd_dataset.scoring.inputs import photographs_in, square_picture

WEIGHTS = Path(__file__).with_name("weights") / "T1.pt"


Network = ParameterNet | PictureParameters


def network(path: Path) -> Network:
    """The network of a file of weights, described by the JSON beside it. Raises ``ConfigError``."""
    if not path.is_file():
        raise ConfigError(f"{path}: no such file: give weights, with a JSON of their name")
    at = JsonPath(str(path.with_suffix(".json")))
    card = at.mapping(read_json(path.with_suffix(".json"), "description of weights"), "")
    if hashlib.sha256(path.read_bytes()).hexdigest() != card.get("sha256"):
        raise ConfigError(f"{path}: not the weights that {at.source} describes: fetch both again")
    found: Network = load_model(at.text(card.get("model"), "model")).build(at.mapping(card.get("sizes"), "sizes"))
    load_weights([path], found)
    return found.eval()


def propose(scan: Path, net: Network, count: int, folder: Path) -> None:
    """Write ``count`` designs for a scan or a folder of pictures, and the measures of its wearer."""
    device, chance = net.decoder.queries.device, torch.Generator().manual_seed(0)
    if isinstance(net, PictureParameters):
        paths = photographs_in(scan)
        views = [np.asarray(square_picture(path)) for path, _ in zip(cycle(paths), range(net.views), strict=False)]
        found = net.proposals(torch.from_numpy(np.stack(views))[None].to(device), count, chance)
    else:
        placed = read_points(scan, net.config.stored_points) - [*CENTRE, 0.0, 0.0, 0.0]
        placed = np.resize(placed, (net.config.stored_points, 6))  # a sparse scan repeats its points
        found = net.proposals(scaled_points(placed[None].astype(np.float32), device), count, chance)
    make_folder(folder)
    for number, answer in enumerate(found):
        write_design(decode_design(answer.codes), folder / f"{number:02}_design_params.yaml")
    write_measurements(size_of(found[0].measures), folder / f"{scan.stem}_measurements.yaml")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a folder of proposals for each scan. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.reconstruction.propose", description=main.__doc__)
    parser.add_argument("scan", nargs="+", type=Path, help="mesh or points of a garment [cm], or folder of pictures")
    parser.add_argument("--count", type=int, default=16, help="designs for each scan (default: 16)")
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="with a JSON of its name (default: T1's)")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda:0 (default: auto)")
    options = parser.parse_args(arguments)
    failed = 0
    try:
        if options.count < 1:
            raise ConfigError(f"--count {options.count}: give 1 or more")
        net = network(options.weights).to(resolve_device(options.device))
    except GcdError as error:
        print(f"propose: {error}", file=sys.stderr)
        return 1
    for scan in options.scan:
        try:
            propose(scan, net, options.count, options.out / scan.stem)
        except GcdError as error:
            print(f"propose: {error}", file=sys.stderr)
            failed += 1
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
