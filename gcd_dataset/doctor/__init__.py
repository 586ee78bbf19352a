"""Examines a data set for faults that harm a training; ``gcd_dataset.verbs.doctor`` runs it.

``checks.py``       every fault, with its effect on a training and its remedy, in order of harm
``garment.py``      faults of one garment: NaN, units, axes, missing arrays, failed drape
``orientation.py``  winding of triangles and outlines, mirrored uv, facing
``sewing.py``       open seams, lengths of sewn edges
``census.py``       shares of kinds, designs and bodies that splits share
``duplicates.py``   equal and nearly equal patterns
``files.py``        tar members without index, shards without manifest, published files without garment
``report.py``       the findings as text and JSON
"""
