"""Quality of drapes: pass rates, crossings, frames."""

from collections.abc import Sequence

import numpy as np

from benchmarks.cases.figures import Figure
from gcd_dataset.generator.drape import DrapeConfig
from gcd_dataset.records import Drape, Outcome

SHARES = (50, 80, 95, 99)
LIMITS = DrapeConfig()


def quality(drapes: Sequence[Drape]) -> list[Figure]:
    """Pass rates, and percentiles of crossing edges: cloth through cloth, cloth through body, and body through cloth.

    ``clean``: the share with ``Outcome.SETTLED`` and no crossing edge of any kind; ``passed``: the share with
    ``Outcome.SETTLED``; ``passed_paper``: the share that passes the checks of Korosteleva et al. (ECCV 2024) alone.
    """
    crossings = {
        "self": [d.self_crossings for d in drapes],
        "body": [d.body_crossings for d in drapes],
        "through": [d.body_through for d in drapes],
    }
    return [
        Figure("clean", float(np.mean([is_clean(d) for d in drapes])), "share"),
        Figure("passed", float(np.mean([d.outcome is Outcome.SETTLED for d in drapes])), "share"),
        Figure("passed_paper", float(np.mean([pass_paper(d) for d in drapes])), "share"),
        *(
            Figure(f"{kind}_p{share}", float(np.percentile(counts, share)), "edges")
            for kind, counts in crossings.items()
            for share in SHARES
        ),
    ]


def is_clean(drape: Drape) -> bool:
    """Whether the drape settled and no edge crosses: cloth through cloth, cloth through body, or body through cloth."""
    return drape.outcome is Outcome.SETTLED and drape.self_crossings + drape.body_crossings + drape.body_through == 0


def pass_paper(drape: Drape) -> bool:
    """Whether the drape rests with few enough crossings, regardless of stretch.

    Stretch is the last check of an ``Outcome``: an overstretched drape has passed the others. A garment that slid off
    does not count as at rest, since its drape is stopped early. The paper's check counts edges of the cloth only.
    """
    if drape.outcome is Outcome.THROUGH_BODY and drape.body_through > 0:
        return drape.body_crossings <= LIMITS.max_body_crossings and drape.self_crossings <= LIMITS.max_self_crossings
    return drape.outcome in (Outcome.SETTLED, Outcome.OVERSTRETCHED)
