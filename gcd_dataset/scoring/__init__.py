"""Scores of predicted patterns: answers of any model, against true patterns or the scoreboard's frozen test sets."""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.scoring.board import result_of, tables
    from gcd_dataset.scoring.folders import Drapes, Scores, score
    from gcd_dataset.scoring.inputs import read_task, write_inputs

__all__ = ["Drapes", "Scores", "read_task", "result_of", "score", "tables", "write_inputs"]

__getattr__, __dir__ = lazy_names(__name__)
