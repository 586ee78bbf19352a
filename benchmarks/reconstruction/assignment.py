"""Assignments of least cost for a batch of tables, on the device that holds them and without waiting for it."""

import torch
import warp as wp
from jaxtyping import Bool, Float, Int
from torch import Tensor

WORST = 1e6  # stands for costs that are no numbers


@wp.kernel(enable_backward=False)
def _assign(
    cost: wp.array3d[wp.float32],
    asked: wp.array2d[wp.bool],
    potential: wp.array2d[wp.float32],
    least: wp.array2d[wp.float32],
    of_row: wp.array2d[wp.float32],
    column_of: wp.array2d[wp.int32],
    way: wp.array2d[wp.int32],
    used: wp.array2d[wp.int32],
    found: wp.array2d[wp.int64],
) -> None:
    """One table for each thread; arrays of numbers of columns have an extra column 0, the row that is added."""
    table = wp.tid()
    rows = cost.shape[1]
    columns = cost.shape[2]
    for j in range(columns + 1):
        potential[j, table] = 0.0
        column_of[j, table] = 0
    for row in range(1, rows + 1):
        of_row[row, table] = 0.0
        if asked[table, row - 1]:
            column_of[0, table] = row
            for j in range(columns + 1):
                least[j, table] = 1.0e30
                used[j, table] = 0
            at = int(0)
            for _step in range(columns + 1):
                if column_of[at, table] == 0:
                    break
                used[at, table] = 1
                present = column_of[at, table]
                delta = float(1.0e30)
                following = int(0)
                for j in range(1, columns + 1):
                    if used[j, table] == 0:
                        reduced = cost[table, present - 1, j - 1] - of_row[present, table] - potential[j, table]
                        if reduced < least[j, table]:
                            least[j, table] = reduced
                            way[j, table] = at
                        if least[j, table] < delta:
                            delta = least[j, table]
                            following = j
                for j in range(columns + 1):
                    if used[j, table] == 1:
                        of_row[column_of[j, table], table] = of_row[column_of[j, table], table] + delta
                        potential[j, table] = potential[j, table] - delta
                    else:
                        least[j, table] = least[j, table] - delta
                at = following
            for _step in range(columns + 1):
                if at == 0:
                    break
                before = way[at, table]
                column_of[at, table] = column_of[before, table]
                at = before
    for j in range(1, columns + 1):
        if column_of[j, table] > 0:
            found[table, column_of[j, table] - 1] = wp.int64(j - 1)


def least_cost(cost: Float[Tensor, "b r c"], asked: Bool[Tensor, "b r"]) -> Int[Tensor, "b r"]:
    """The column of each row ``asked`` for, different columns at least total cost; 0 for the other rows.

    Shortest augmenting paths (Jonker and Volgenant, Computing 38, 1987), a thread for each table. There are at least as
    many columns as rows. Costs that are not finite count as ``WORST``.
    """
    wp.init()
    batch, rows, columns = cost.shape
    device = cost.device
    cost = torch.nan_to_num(cost.detach().float(), nan=WORST, posinf=WORST, neginf=-WORST).contiguous()
    numbers = torch.empty(2, columns + 1, batch, device=device)
    of_row = torch.empty(rows + 1, batch, device=device)
    indices = torch.empty(3, columns + 1, batch, dtype=torch.int32, device=device)
    found = torch.zeros(batch, rows, dtype=torch.int64, device=device)
    arrays = [cost, asked.contiguous(), numbers[0], numbers[1], of_row, *indices, found]
    stream = wp.stream_from_torch(torch.cuda.current_stream(device)) if cost.is_cuda else None
    inputs = [wp.from_torch(array, requires_grad=False) for array in arrays]
    wp.launch(_assign, dim=batch, inputs=inputs, device=wp.device_from_torch(device), stream=stream, block_dim=32)
    return found
