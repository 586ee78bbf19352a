"""A fabric on a mesh: how stiff the springs of a face and the hinge of an edge are, by their directions in the flat."""

import warp as wp

from gcd_dataset.generator.drape.fabric import DYNE_CM, DYNES_PER_CM, POISSON, Fabric, shear_stiffness

wp.set_module_options({"enable_backward": False})

# Bergou et al.'s energy takes the jump of the slope over each edge for the curvature round it. Where positions are
# known at the vertices alone the jumps alternate: on equilateral triangles their squares make three times the sheet's.
EXCESS = 3.0
SLIVER = 0.12  # sin a sin b sin c of a face's angles: about 7° and two of 86°
LEAST_BEND = 0.5  # of the softer direction's rigidity


@wp.struct
class Sheet:
    """A fabric."""

    mass: float  # g/cm²
    membrane: float  # g/s², along the warp
    bend_warp: float  # g cm²/s², that Bergou et al.'s energy is multiplied by
    bend_weft: float  # g cm²/s²
    grained: int  # 1 where it stretches otherwise along the weft or the bias than along the warp
    stretch: wp.mat33d  # tension by strain over ``membrane``: along the weft, along the warp, in shear


def sheet_of(fabric: Fabric) -> Sheet:
    """The fabric as the kernels want it."""
    sheet = Sheet()
    sheet.mass, sheet.membrane = fabric.mass, fabric.membrane
    sheet.bend_warp, sheet.bend_weft = (rigidity * DYNE_CM / EXCESS for rigidity in fabric.bend)
    sheet.grained = int(not fabric.alike)
    warp, weft, _ = fabric.pull
    plain = 1 / (1 - POISSON**2)
    across = POISSON * (warp * weft) ** 0.5
    unit = DYNES_PER_CM / fabric.membrane
    stretch = [plain * weft, plain * across, 0, plain * across, plain * warp, 0, 0, 0, shear_stiffness(fabric.pull)]
    sheet.stretch = wp.mat33d([unit * value for value in stretch])
    return sheet


@wp.func
def strain_row(flat: wp.array2d(dtype=wp.vec2d), f: int, side: int) -> wp.vec3d:
    """What strains along weft and warp and a shear add to the strain of a side."""
    along = wp.normalize(flat[f, (side + 1) % 3] - flat[f, side])
    return wp.vec3d(along[0] * along[0], along[1] * along[1], along[0] * along[1])


@wp.func
def springs_of(flat: wp.array2d(dtype=wp.vec2d), f: int, sheet: Sheet) -> wp.mat33d:
    """The energy of a face by the strains of its sides, times two, over area and membrane stiffness.

    Any three sides tell the whole strain, so this is the sheet itself; slivers are left with three equal springs.
    """
    rows = wp.matrix_from_rows(strain_row(flat, f, 0), strain_row(flat, f, 1), strain_row(flat, f, 2))
    if wp.abs(wp.determinant(rows)) < wp.float64(SLIVER):
        return wp.identity(n=3, dtype=wp.float64)
    strains = wp.inverse(rows)
    return wp.transpose(strains) * sheet.stretch * strains


@wp.func
def bend_share(flat: wp.array2d(dtype=wp.vec2d), f: int, side: int) -> wp.float64:
    """How far cloth that is folded along a side bends along the weft: 1 all, 0 along the warp."""
    along = wp.normalize(flat[f, (side + 1) % 3] - flat[f, side])
    return along[1] * along[1]


@wp.func
def hinge_rigidity(sheet: Sheet, share: wp.float64) -> float:
    """Of a hinge, so that a mesh of equilateral triangles with a side along the weft bends as the fabric does.

    Bent along the warp only hinges along the weft move (share 0), bent along the weft (share 3/4 and 0) all do: with
    their jumps 2, 2 and -1 the sheet's rigidity is 8/9 and 1/9 of theirs.
    """
    if sheet.bend_warp == sheet.bend_weft:
        return sheet.bend_warp
    rigidity = sheet.bend_warp + 1.5 * float(share) * (sheet.bend_weft - sheet.bend_warp)
    return wp.max(rigidity, LEAST_BEND * wp.min(sheet.bend_warp, sheet.bend_weft))
