"""Examples for the help of each verb of ``gcd``."""

from collections.abc import Mapping

EXAMPLES: Mapping[str, tuple[str, str]] = {
    "generate": (
        "gcd generate shards --count 1000 --bodies both --resolution 2 --workers 8",
        "gcd generate smoke --recipe smoke-64",
    ),
    "drape": (
        "gcd drape shirt_specification.json --out draped",
        "gcd drape *_specification.json --body female:7 --fabric denim --out draped --resolution 2",
    ),
    "fit": (
        "gcd fit design_params.yaml --body scan.obj --out fitted",
        "gcd fit design_params.yaml --body female:7 --out fitted --resolution 2 --fabric denim",
    ),
    "measure": (
        "gcd measure scan.obj --out measures.yaml",
        "gcd measure --shape random:7",
    ),
    "validate": (
        "gcd validate shirt_specification.json",
        "gcd validate *_specification.json --errors",
    ),
    "show": (
        "gcd show shards --index 3 --html garment.html",
        "gcd show shirt_specification.json --svg pattern.svg",
    ),
    "info": (
        "gcd info shards",
        "gcd info org/garments",
    ),
    "verify": (
        "gcd verify shards --full",
        "gcd verify smoke --recipe smoke-64",
    ),
    "doctor": (
        "gcd doctor shards",
        "gcd doctor GarmentCodeData_v2 --quick --json",
    ),
    "index": (
        "gcd index shards",
        "gcd index s3://bucket/shards",
    ),
    "download": (
        "gcd download org/garments --split test",
        "gcd download org/garments --no-views --out garments",
    ),
    "publish": (
        "gcd publish shards org/garments --dry-run",
        "gcd publish shards org/garments --shares 90,5,5 --license cc-by-4.0",
    ),
    "convert": (
        "gcd convert GarmentCodeData_v2 shards",
        "gcd convert GarmentCodeData_v2 shards --bodies default --workers 8",
    ),
    "export": (
        "gcd export shards --hdf5 train.h5",
        "gcd export shirt_specification.json --pdf shirt.pdf --seam-allowance 1.5",
    ),
}
"""Verb to two commands."""
