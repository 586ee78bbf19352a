"""Weights in bfloat16 that others can load, and the moments of the optimiser with which a training goes on.

``weights.pt`` holds the averaged weights: 2 bytes a parameter, buffers as they are. ``moments_0.pt`` … hold the means
of AdamW in parts of at most 15 MB, for machines between which only small files travel.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from torch import Tensor, nn

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import drafted

WEIGHTS, PART = "weights.pt", 14_500_000  # bytes
MEANS = ("exp_avg", "exp_avg_sq")
DAMAGED = (RuntimeError, EOFError, ValueError, LookupError, UnpicklingError)  # of ``torch.load``


def save_weights(folder: Path, averaged: nn.Module, optimizer: torch.optim.Optimizer, model: nn.Module) -> None:
    """Write ``weights.pt`` and the moments of the parameters of ``model`` into a folder."""
    for old in folder.glob("moments_*.pt"):
        old.unlink()
    own = {name for name, _ in averaged.named_parameters()}
    weights = {name: _small(value) if name in own else value.cpu() for name, value in averaged.state_dict().items()}
    _save(weights, folder / WEIGHTS)
    for number, part in enumerate(_parts(model, optimizer)):
        _save(part, folder / f"moments_{number}.pt")


def load_weights(paths: Sequence[Path], model: nn.Module, optimizer: torch.optim.Optimizer | None = None) -> None:
    """Load the mean of ``weights.pt`` files into a model, and the moments beside a single one into its optimiser.

    Weights of which one was trained on from the other are often better in their mean than either (Wortsman et al.,
    Model soups, ICML 2022). Raises ``ConfigError`` for a file that is none, and for weights of another network.
    """
    try:
        first, *others = [_load(path) for path in paths]
        several = {name: torch.stack([value, *(each[name] for each in others)]) for name, value in first.items()}
        model.load_state_dict({name: values.float().mean(dim=0) for name, values in several.items()})
        if optimizer is not None and len(paths) == 1:
            parts = [_load(part) for part in paths[0].parent.glob("moments_*.pt")]
            found = {name: each for part in parts for name, each in part.items()}
            names = {parameter: name for name, parameter in model.named_parameters()}
            order = [names[parameter] for group in optimizer.param_groups for parameter in group["params"]]
            states = {number: found[name] for number, name in enumerate(order) if name in found}
            optimizer.load_state_dict({**optimizer.state_dict(), "state": states})  # in the parameters' dtype and place
    except (*DAMAGED, OSError, TypeError) as error:
        given = ", ".join(map(str, paths))
        raise ConfigError(
            f"{given}: no weights of this network ({error!s:.200}): give its --model and --set"
        ) from error


def read_checkpoint(path: Path, identity: Mapping[str, Any], device: torch.device) -> dict[str, Any]:
    """The state of a training that goes on. Raises ``ConfigError`` for a damaged file, and one of other options."""
    try:
        state: dict[str, Any] = torch.load(path, map_location=device, weights_only=True)
        theirs = state["config"]
    except DAMAGED as error:
        raise ConfigError(f"{path}: no checkpoint ({error!s:.99}): delete it, the training starts again") from error
    for name, value in identity.items():
        if theirs.get(name) != value:
            raise ConfigError(f"{path}: of a training with {name} {theirs.get(name)}, not {value}: give another folder")
    return state


def _parts(model: nn.Module, optimizer: torch.optim.Optimizer) -> Iterator[dict[str, Any]]:
    part: dict[str, Any] = {}
    size = 0
    for name, parameter in model.named_parameters():
        if (state := optimizer.state.get(parameter)) is None:
            continue
        bytes_of = 2 * len(MEANS) * parameter.numel()
        if part and size + bytes_of > PART:
            yield part
            part, size = {}, 0
        part[name] = {"step": state["step"].cpu(), **{key: _small(state[key]) for key in MEANS}}
        size += bytes_of
    if part:
        yield part


def _small(values: Tensor) -> Tensor:
    return values.detach().to("cpu", torch.bfloat16)


def _save(state: dict[str, Any], path: Path) -> None:
    with drafted(path) as draft:
        torch.save(state, draft)


def _load(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    return found
