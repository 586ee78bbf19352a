"""What a training step costs: time, and the operations that it starts on the device.

    python -m benchmarks.reconstruction.step_profile panel_set --task T0 --train 512 --steps 50
    python -m benchmarks.reconstruction.step_profile panel_set --task T0 --train 4 --batch 4 --device cpu

Prints milliseconds a step, after a warm-up of as many steps; on a GPU also the time that it computes, the number of
kernels, and those that take longest; on a CPU the operations of a step that are no views, most of which are one kernel
on a GPU. The other options are those of ``train``.
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from benchmarks.reconstruction.models import MODELS, load_model
from benchmarks.reconstruction.train import Options, add_arguments, load_split, options_from, require_usable
from benchmarks.reconstruction.training import TrainConfig, step_of
from gcd_dataset.errors import ConfigError, GcdError

STEPS = 20
SHOWN = 15  # kernels
FREE = ("aten::empty", "aten::empty_like", "aten::new_empty", "aten::empty_strided", "aten::detach")
"""Operations that compute nothing."""


class Operations(TorchDispatchMode):
    """Counts the operations in its context, those of backward passes too, without views."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.counts: Counter[str] = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        returned = (value.alias_info for value in func._schema.returns)
        if func._schema.name not in FREE and not any(info is not None and not info.is_write for info in returned):
            self.counts[func._schema.name] += 1
        return func(*args, **(kwargs or {}))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="step_profile", description=__doc__, formatter_class=formatter)
    parser.add_argument("model", choices=MODELS)
    add_arguments(parser)
    args = parser.parse_args(arguments)
    args.steps = args.steps or STEPS
    try:
        _profile(options_from(args, args.model))
    except GcdError as error:
        print(f"step_profile {args.model}: {error}", file=sys.stderr)
        return 1
    return 0


def _profile(options: Options) -> None:
    module, config = load_model(options.model), options.config
    if not hasattr(module, "build"):
        raise ConfigError(f"{options.model} has no training: choose a network")
    require_usable(options)
    device = torch.device(options.device)
    split = load_split(replace(options, test=1, leave_out=""))
    torch.manual_seed(config.seed)
    learner = module.build(smoke=options.smoke, options=options.sizes)
    step = step_of(learner, learner.prepare(split.train, device=device), config, device=device)
    _ms_a_step(step, config, device)
    print(f"{options.model}: {_ms_a_step(step, config, device):.1f} ms a step of {config.batch} on {device}")
    if device.type == "cuda":
        _print_kernels(step, config, device)
        return
    with Operations() as operations:
        step()
    print(f"{operations.counts.total()} operations a step")
    for name, count in operations.counts.most_common(SHOWN):
        print(f"{count:8d} {name}")


def _ms_a_step(step: Callable[[], None], config: TrainConfig, device: torch.device) -> float:
    begun = time.perf_counter()
    for _ in range(config.steps):
        step()
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return 1e3 * (time.perf_counter() - begun) / config.steps


def _print_kernels(step: Callable[[], None], config: TrainConfig, device: torch.device) -> None:
    from torch.profiler import ProfilerActivity, profile

    with profile(activities=[ProfilerActivity.CUDA]) as profiled:
        _ms_a_step(step, config, device)
    kernels = sorted(profiled.key_averages(), key=lambda one: -one.device_time_total)
    count, total = sum(one.count for one in kernels), sum(one.device_time_total for one in kernels)
    print(f"{count / config.steps:.0f} kernels and copies a step, {total / config.steps / 1e3:.1f} ms of the device")
    for one in kernels[:SHOWN]:
        print(f"{one.device_time_total / config.steps / 1e3:8.2f} ms {one.count / config.steps:6.0f} {one.key[:90]}")


if __name__ == "__main__":
    sys.exit(main())
