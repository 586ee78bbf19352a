"""A fabric on a mesh: stiffness of a face's springs and an edge's hinge, by their directions relative to the grain."""

import warp as wp

from gcd_dataset.generator.drape.fabrics import DYNE_CM, DYNES_PER_CM, POISSON, Fabric, shear_stiffness

wp.set_module_options({"enable_backward": False})

# Bergou et al. (2006) estimate the curvature at each edge by the jump of the slope. The jump depends on the direction
# of the edge: on equilateral triangles the sum of their squares is three times that of the smooth sheet.
EXCESS = 3.0
SLIVER = 0.12  # a face is a sliver if the product of its angles' sines is smaller: angles of 7°, 86° and 87°
LEAST_BEND = 0.5  # lower limit of a hinge's rigidity, as a share of the rigidity along the softer direction


@wp.struct
class Sheet:
    """A fabric in the units of the kernels."""

    mass: float  # g/cm²
    membrane: float  # g/s², along the warp
    bend_warp: float  # g cm²/s², factor of Bergou et al.'s energy: rigidity over ``EXCESS``
    bend_weft: float  # g cm²/s²
    grained: int  # 1 for an anisotropic tensile stiffness
    stretch: wp.mat33d  # stiffness matrix over ``membrane``, rows and columns: weft, warp, shear


def sheet_of(fabric: Fabric) -> Sheet:
    """The kernels' struct of a fabric."""
    sheet = Sheet()
    sheet.mass, sheet.membrane = fabric.mass, fabric.membrane
    sheet.bend_warp, sheet.bend_weft = (rigidity * DYNE_CM / EXCESS for rigidity in fabric.bend)
    sheet.grained = int(not fabric.isotropic)
    warp, weft, _ = fabric.pull
    plain = 1 / (1 - POISSON**2)
    across = POISSON * (warp * weft) ** 0.5
    unit = DYNES_PER_CM / fabric.membrane
    stretch = [plain * weft, plain * across, 0, plain * across, plain * warp, 0, 0, 0, shear_stiffness(fabric.pull)]
    sheet.stretch = wp.mat33d([unit * value for value in stretch])
    return sheet


@wp.func
def strain_row(flat: wp.array2d(dtype=wp.vec2d), f: int, side: int) -> wp.vec3d:
    """Coefficients of weft strain, warp strain and shear in the strain along a side."""
    along = wp.normalize(flat[f, (side + 1) % 3] - flat[f, side])
    return wp.vec3d(along[0] * along[0], along[1] * along[1], along[0] * along[1])


@wp.func
def springs_of(flat: wp.array2d(dtype=wp.vec2d), f: int, sheet: Sheet) -> wp.mat33d:
    """Matrix of a face's energy in the strains of its sides: twice the energy over area and membrane stiffness.

    Three side strains determine the strain of the face, so this is exact. Slivers get three equal springs.
    """
    rows = wp.matrix_from_rows(strain_row(flat, f, 0), strain_row(flat, f, 1), strain_row(flat, f, 2))
    if wp.abs(wp.determinant(rows)) < wp.float64(SLIVER):
        return wp.identity(n=3, dtype=wp.float64)
    strains = wp.inverse(rows)
    return wp.transpose(strains) * sheet.stretch * strains


@wp.func
def bend_share(flat: wp.array2d(dtype=wp.vec2d), f: int, side: int) -> wp.float64:
    """Share of the weft in the bending of cloth folded along a side: 1 along the weft, 0 along the warp."""
    along = wp.normalize(flat[f, (side + 1) % 3] - flat[f, side])
    return along[1] * along[1]


@wp.func
def hinge_rigidity(sheet: Sheet, share: wp.float64) -> float:
    """Rigidity of a hinge, so that a mesh of equilateral triangles with a side along the weft bends like the fabric.

    Bending along the warp moves only hinges along the weft (share 0); bending along the weft moves all hinges (shares
    3/4, 3/4 and 0), with jumps 2, 2 and -1. Jumps count squared: the sheet's rigidity along the weft is 8/9 of the
    rigidity of hinges with share 3/4, plus 1/9 of the rigidity of hinges with share 0.
    """
    if sheet.bend_warp == sheet.bend_weft:
        return sheet.bend_warp
    rigidity = sheet.bend_warp + 1.5 * float(share) * (sheet.bend_weft - sheet.bend_warp)
    return wp.max(rigidity, LEAST_BEND * wp.min(sheet.bend_warp, sheet.bend_weft))
