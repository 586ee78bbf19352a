"""The edge token network: its order and sequence, that answers are closed, that the cache changes nothing, and that it
learns."""

from collections.abc import Callable
from dataclasses import fields, replace

import pytest
import torch

from benchmarks.reconstruction.edge_decoder import decode
from benchmarks.reconstruction.edge_sequence import canonical, sequence_of, tokens_of
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models.edge_tokens import SMALL, EdgeTokens, build
from benchmarks.reconstruction.panel_targets import PanelTargets, patterns_from
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.metrics import score_pattern
from tests.benchmarks.reconstruction.conftest import shuffled, started_elsewhere

CPU = torch.device("cpu")


def learner(**sizes: int) -> EdgeTokens:
    torch.manual_seed(0)
    return build({**SMALL, "points": 128, "stored_points": 512, **sizes})


def undecided(**sizes: int) -> EdgeTokens:
    """A network without training whose kinds, corners and seams vary."""
    network = learner(**sizes).eval()
    with torch.no_grad():
        for name, weights in network.decoder.named_parameters():
            if name.startswith("next_") and name.endswith("2.weight"):
                weights.mul_(20.0)
    return network


@pytest.fixture(scope="module")
def targets(six: GarmentSet) -> PanelTargets:
    return learner().prepare(six, device=CPU).whole


# ------------------------------------------------------------------------------------------------ order and sequence


@pytest.mark.parametrize("change", [shuffled, started_elsewhere, canonical])
def test_the_order_depends_on_the_garment_alone(
    change: Callable[[PanelTargets], PanelTargets], targets: PanelTargets
) -> None:
    again = canonical(change(targets))
    empty = ~targets.exists
    for field in fields(targets):
        one, other = getattr(targets, field.name), getattr(again, field.name)
        if one.shape[:2] == empty.shape:
            one, other = one[~empty], other[~empty]
        assert torch.equal(one, other), field.name


def test_the_garment_remains_the_same_in_canonical_order(targets: PanelTargets, six: GarmentSet) -> None:
    for k, pattern in enumerate(patterns_from(targets)):
        score = score_pattern(pattern, six.pattern(k))
        assert (score.combinatorial, score.garment_perfect) == (1, 1)
        assert score.iou > 0.99


# ------------------------------------------------------------------------------------------------------- the network


def test_a_state_depends_on_no_later_token(targets: PanelTargets) -> None:
    network = learner().eval()
    tokens = tokens_of(targets, sequence_of(targets))
    memory = torch.randn(6, 8, network.config.width)
    changed = replace(tokens, end=tokens.end.clone())
    changed.end[:, 9:] += 1.0
    with torch.no_grad():
        one, other = network.decoder(tokens, memory), network.decoder(changed, memory)
    assert torch.allclose(one[:, :9], other[:, :9], atol=1e-5)
    assert not torch.allclose(one[:, 9], other[:, 9], atol=1e-2)


def test_cached_decoding_says_what_one_pass_says() -> None:
    network = undecided()
    decoder, memory = network.decoder, torch.randn(5, 8, network.config.width)
    with torch.no_grad():
        answer = decode(decoder, memory)
        sequence = sequence_of(answer)
        states = decoder(tokens_of(answer, sequence), memory)
    assert (answer.edge_panels >= 0).sum() > 20
    for garment in range(5):
        for row in torch.nonzero(answer.edge_panels[garment] >= 0)[:, 0].tolist():
            at, panel = int(sequence.at_edges[garment, row]), int(answer.edge_panels[garment, row])
            end, bends = decoder.edge(states[garment, at - 1])
            slot = int(answer.edge_slots[garment, row])
            if slot + 1 < answer.edge_counts[garment, panel]:
                assert torch.allclose(end, answer.corners[garment, panel, slot + 1], atol=1e-3)
            if answer.edge_kinds[garment, row]:
                assert torch.allclose(bends, answer.bends[garment, panel, slot], atol=1e-3)
        for panel in range(int(answer.exists[garment].sum())):
            corner, centre, _ = decoder.first_corner(states[garment, int(sequence.at_panels[garment, panel]) - 1])
            assert torch.allclose(corner, answer.corners[garment, panel, 0], atol=1e-3)
            assert torch.allclose(centre, answer.centres[garment, panel], atol=1e-3)


@pytest.mark.parametrize("sizes", [{}, {"queries": 3, "slots": 5, "edges": 10}])
def test_every_answer_is_closed_and_within_the_sizes(sizes: dict[str, int]) -> None:
    network = undecided(**sizes)
    config = network.config
    with torch.no_grad():
        answer = decode(network.decoder, torch.randn(16, 8, config.width))
    counts = torch.where(answer.exists, answer.edge_counts, 0)
    assert answer.exists.any(dim=1).all()
    assert (counts[answer.exists] >= 3).all()
    assert counts.max() <= config.slots
    assert counts.sum(dim=1).max() <= config.edges
    assert torch.equal(counts.sum(dim=1), (answer.edge_panels >= 0).sum(dim=1))
    rows = torch.arange(config.edges).expand_as(answer.partners)
    sewn = answer.partners >= 0
    assert torch.equal(answer.partners.gather(1, answer.partners.clamp(min=0))[sewn], rows[sewn])
    assert not (answer.partners == rows).any()
    for pattern in patterns_from(answer):
        assert not [fault for fault in check_pattern(pattern) if fault.severity is Severity.ERROR]
