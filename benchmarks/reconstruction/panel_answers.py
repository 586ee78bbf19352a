"""Answers of a ``PanelDecoder``: panels that exist, their edges, and the likeliest seams."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from benchmarks.reconstruction.panel_net import Edges, PanelDecoder
from benchmarks.reconstruction.panel_targets import PanelTargets

LEAST_EDGES = 3  # of a panel


def answers_of(decoder: PanelDecoder, tokens: Float[Tensor, "b t w"]) -> PanelTargets:
    """The predictions in the form of the targets; panels are those with a probability above 1/2, at least one."""
    layers, panels = decoder(tokens)
    last = layers[-1]
    exists = (last.exists > 0) | (last.exists == last.exists.amax(dim=1, keepdim=True))
    counts = LEAST_EDGES + last.edges[..., LEAST_EDGES:].argmax(dim=-1)
    edges = edges_of(exists, counts, decoder.config.edges)
    moved, features = decoder.mover(edges, panels, last, tokens)
    sewn = decoder.seams(edges, features, moved)
    partners = _partners(sewn.partners, edges.exists)
    mutual = partners.clamp(min=0)[..., None]
    return PanelTargets(
        points=tokens.new_zeros(len(tokens), 0, 6),
        exists=exists,
        corners=moved.corners,
        bends=moved.bends,
        extents=moved.extents,
        centres=moved.centres,
        rotations=moved.rotations,
        edge_counts=counts,
        labels=moved.labels.argmax(dim=-1),
        slimness=torch.zeros_like(last.exists),
        edge_panels=torch.where(edges.exists, edges.queries, -1),
        edge_slots=edges.slots,
        edge_kinds=(sewn.kinds > 0).long(),
        edge_labels=common_labels(sewn.labels, partners),
        partners=partners,
        turned=sewn.turned.gather(2, mutual)[..., 0] > 0,
    )


def edges_of(exists: Bool[Tensor, "b q"], counts: Int[Tensor, "b q"], room: int) -> Edges:
    """The edges of the queries that exist; a panel beyond the room gets none."""
    shape = (len(exists), room)
    queries, slots, following = (np.zeros(shape, np.int64) for _ in range(3))
    known = np.zeros(shape, bool)
    for garment, (chosen, numbers) in enumerate(zip(exists.cpu().numpy(), counts.cpu().numpy(), strict=True)):
        filled = 0
        for query in np.flatnonzero(chosen).tolist():
            count = int(numbers[query])
            if filled + count > room:
                continue
            part, loop = slice(filled, filled + count), np.arange(count)
            queries[garment, part], known[garment, part] = query, True
            slots[garment, part], following[garment, part] = loop, np.roll(loop, -1)
            filled += count
    return Edges(*(torch.from_numpy(array).to(counts.device) for array in (queries, slots, following, known)))


def _partners(logits: Float[Tensor, "b e f"], exists: Bool[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """The partner of each edge, or -1: the likeliest pairs first, while they are likelier than two free edges."""
    log = logits.float().log_softmax(dim=-1)
    pairs, free = log[..., :-1] + log[..., :-1].transpose(1, 2), log[..., -1]
    return best_pairs(pairs - free[:, :, None] - free[:, None], exists)


def best_pairs(gains: Float[Tensor, "b e e"], exists: Bool[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """The partner of each edge, or -1: pairs in the order of their gains, while these are above 0.

    Of ``gains`` only the upper triangle is read.
    """
    partners = np.full(exists.shape, -1)
    for gain, known, chosen in zip(gains.cpu().numpy(), exists.cpu().numpy(), partners, strict=True):
        left, right = np.nonzero(np.triu((gain > 0) & known[:, None] & known[None], 1))
        for k in np.argsort(-gain[left, right], kind="stable").tolist():
            if chosen[left[k]] < 0 and chosen[right[k]] < 0:
                chosen[left[k]], chosen[right[k]] = right[k], left[k]
    return torch.from_numpy(partners).to(gains.device)


def common_labels(logits: Float[Tensor, "b e l"], partners: Int[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """The likeliest label of each edge, of both edges of a seam: sewn edges with different labels are a fault."""
    others = logits.gather(1, partners.clamp(min=0)[..., None].expand_as(logits))
    return (logits + torch.where((partners >= 0)[..., None], others, 0.0)).argmax(dim=-1)
