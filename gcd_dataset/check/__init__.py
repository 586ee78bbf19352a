"""Finds faults of data sets, for ``gcd check``, and summarises data sets, for ``gcd info``.

``examine`` reads a data set as a training would, and reports what would stop or spoil it.

``checks.py``       every fault, with its effect on a training and its remedy, in order of harm
``examination.py``  reads every garment once, then compares them
``garments.py``     faults of one garment: NaN, units, axes, winding, seams, missing arrays, failed drape
``sets.py``         faults of all garments together: shares of kinds, and designs, bodies and patterns of two splits
``files.py``        damaged and unlisted files, shards without manifest, published files without garment
``report.py``       the findings as text and JSON
``summary.py``      counts, shares and plots of a data set
``recipes.py``      whether a folder is the data set of a recipe
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.check.checks import Check, Harm
    from gcd_dataset.check.examination import examine
    from gcd_dataset.check.report import Finding, Report, SplitSummary

__all__ = ["Check", "Finding", "Harm", "Report", "SplitSummary", "examine"]

__getattr__, __dir__ = lazy_names(__name__)
