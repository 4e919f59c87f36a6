"""Rows of a cloud: what is known of a patch of points, and whether two patches are one plane.

A row holds the sum of weights (one over variance), the centroid and the scatter about it, weighted
alike. Of a patch that has a plane the scatter across the plane is taken out and its errors are in
the weights, so that rows of one plane add up to the information on it: 1 / WEIGHT is the variance
of the offset at the centroid and the inverse of the scatter in the plane that of the slopes.
"""

from __future__ import annotations

import math

from planewise.kernels.jit import compiled, internal
from planewise.kernels.symmetric import determinant, quadratic_form
from planewise.kernels.walk import CHORD, MEET, PLANE_BEND, PLANE_OFFSET, TOUCHING

ROW = 18
WEIGHT, CX, CY, CZ = 0, 1, 2, 3
XX, XY, XZ, YY, YZ, ZZ = 4, 5, 6, 7, 8, 9
COUNT, AREA, FREE, MISFIT = 10, 11, 12, 13  # points; m^2; nats as patches of their own; discord
NX, NY, NZ, CELLS = 14, 15, 16, 17  # normal; cells it was made of

# Variance of the slope that cubes cut into sheets, in (variance of a point / area)^2. Sides that
# lean by an angle a against the normal tilt a sheet's points by 12 tan a; rms of all directions.
CUT = 66.0
APART = 1e6  # discord of planes that are far from parallel
_STEEP = 0.5  # least cosine between normals that are compared
_BEND_SMALL, _BEND_LARGE = PLANE_BEND


@internal
def eigenvalues(xx, xy, xz, yy, yz, zz):  # type: ignore[no-untyped-def]
    """Eigenvalues of a symmetric 3 x 3 matrix, the largest first, by the trigonometric formula."""
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    off = xy * xy + xz * xz + yz * yz
    size = math.sqrt((a * a + b * b + c * c + 2.0 * off) / 6.0)
    if not size > 0.0:
        return mean, mean, mean
    half = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    half /= 2.0 * size * size * size
    turn = math.acos(min(1.0, max(-1.0, half))) / 3.0
    largest = mean + 2.0 * size * math.cos(turn)
    least = mean + 2.0 * size * math.cos(turn + 2.0 * math.pi / 3.0)
    return largest, 3.0 * mean - largest - least, least


@internal
def write_normal(row):  # type: ignore[no-untyped-def]
    """Write the normal: the eigenvector of the least eigenvalue.

    Returns the least eigenvalue, by the normal, and the other two as far as they are known.
    """
    xx, xy, xz, yy, yz, zz = row[4], row[5], row[6], row[7], row[8], row[9]
    largest, middle, least = eigenvalues(xx, xy, xz, yy, yz, zz)
    a, b, c = xx - least, yy - least, zz - least
    # Each two rows of S - least I are orthogonal to the normal: the longest product is the best.
    px, py, pz = xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy
    qx, qy, qz = xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz
    rx, ry, rz = b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz
    p, q, r = px * px + py * py + pz * pz, qx * qx + qy * qy + qz * qz, rx * rx + ry * ry + rz * rz
    if q > p:
        px, py, pz, p = qx, qy, qz, q
    if r > p:
        px, py, pz, p = rx, ry, rz, r
    if not p > 0.0:
        row[NX], row[NY], row[NZ] = 0.0, 0.0, 1.0
        return zz, largest, middle
    scale = 1.0 / math.sqrt(p)
    nx, ny, nz = px * scale, py * scale, pz * scale
    row[NX], row[NY], row[NZ] = nx, ny, nz
    across = nx * (xx * nx + 2.0 * (xy * ny + xz * nz)) + ny * (yy * ny + 2.0 * yz * nz)
    return max(across + zz * nz * nz, 0.0), largest, middle


@internal
def add_row(row, other):  # type: ignore[no-untyped-def]
    """Add the weights, centroid and scatter of another patch, and what else is summed."""
    weight = row[WEIGHT] + other[WEIGHT]
    share = other[WEIGHT] / weight
    dx, dy, dz = other[CX] - row[CX], other[CY] - row[CY], other[CZ] - row[CZ]
    joint = row[WEIGHT] * share
    row[CX] += share * dx
    row[CY] += share * dy
    row[CZ] += share * dz
    row[XX] += other[XX] + joint * dx * dx
    row[XY] += other[XY] + joint * dx * dy
    row[XZ] += other[XZ] + joint * dx * dz
    row[YY] += other[YY] + joint * dy * dy
    row[YZ] += other[YZ] + joint * dy * dz
    row[ZZ] += other[ZZ] + joint * dz * dz
    row[WEIGHT] = weight
    for e in range(COUNT, MISFIT + 1):
        row[e] += other[e]
    row[CELLS] += other[CELLS]


@internal
def make_plane(row, white, hopeless, tilt, least, offset_share, prior, wider):  # type: ignore[no-untyped-def]
    """Make the row of points the row of a patch that has a plane.

    white: variance against the weights; hopeless: the same per degree of freedom beyond which
    points have no plane; tilt: largest variance of a slope; least: number of points; offset_share:
    of the white variance, what all points of a patch share; prior: of the variance of the offset in
    areas and of a slope, where a patch has nothing to do with its neighbours; wider: standard
    deviations by which points have to scatter more along the plane than across it, for about a line
    they do so by chance.

    Returns 1 if it has one, 0 if the points do not tell, -1 if they are no plane.
    """
    count = row[COUNT]
    if count < least:
        return 0
    chi2, largest, middle = write_normal(row)
    factor = chi2 / (count - 3.0)
    noise = max(white, factor)
    if not middle > 0.0 or white / middle > tilt:
        return 0
    if middle - chi2 < wider * white * math.sqrt(count):
        return 0
    # Of a rectangle with this scatter; the root of its determinant has the mean (n - 2) / n.
    area = 12.0 * math.sqrt(largest * middle) / row[WEIGHT] * count / (count - 2.0)
    own = white * count / row[WEIGHT]  # variance of a point
    if factor > hopeless * white:
        return -1
    if noise / middle > tilt:
        return -1
    nx, ny, nz = row[NX], row[NY], row[NZ]
    row[XX] -= chi2 * nx * nx
    row[XY] -= chi2 * nx * ny
    row[XZ] -= chi2 * nx * nz
    row[YY] -= chi2 * ny * ny
    row[YZ] -= chi2 * ny * nz
    row[ZZ] -= chi2 * nz * nz
    # Slopes err by what cubes cut, at least: S becomes (S^-1 + cut)^-1 in the plane.
    p, q = largest / noise, middle / noise
    cut = max(CUT * (own / area) * (own / area) - 1.0 / q, 0.0)
    more, less = cut * p * q, 1.0 / ((1.0 + cut * p) * (1.0 + cut * q))
    for e in range(XX, ZZ + 1):
        row[e] *= less / noise
    more *= less
    row[XX] += more * (1.0 - nx * nx)
    row[XY] -= more * nx * ny
    row[XZ] -= more * nx * nz
    row[YY] += more * (1.0 - ny * ny)
    row[YZ] -= more * ny * nz
    row[ZZ] += more * (1.0 - nz * nz)
    row[AREA] = area
    row[WEIGHT] = 1.0 / (noise / row[WEIGHT] + offset_share * own)
    v1, v2 = 1.0 / p, 1.0 / q
    far = (1.0 + prior[0] * row[AREA] * row[WEIGHT]) * (1.0 + prior[1] / v1) * (1.0 + prior[1] / v2)
    # Half the mean of chi^2 with three degrees of freedom: what a free plane fits away.
    row[FREE] = (0.5 * math.log(far) + 1.5) * min(1.0, (count / 64.0)) ** 0.25
    row[MISFIT], row[CELLS] = 0.0, 1.0
    return 1


@internal
def plane_axes(nx, ny, nz):  # type: ignore[no-untyped-def]
    """Two axes in a plane, from its normal without a singularity (Duff and others)."""
    sign = 1.0 if nz >= 0.0 else -1.0
    k = -1.0 / (sign + nz)
    q = nx * ny * k
    return 1.0 + sign * nx * nx * k, sign * q, -sign * nx, q, sign + ny * ny * k, -ny


@compiled
def compare(rows, i, j, wander, offset_prior, slope_prior):  # type: ignore[no-untyped-def]
    """Are two of rows one plane? Their discord, and the evidence that it would be a coincidence.

    In the plane of the larger one, where they meet: delta is the difference of their offsets and
    slopes, C its covariance, with what `wander` makes of it: an error that drifts (m^2 / m), and
    pieces of one surface that lean against each other (square of an angle).
    discord = delta' C^-1 delta; evidence = 1/2 ln det(C + S0) / det C with S0 the prior of a plane
    that has nothing to do with the other.
    """
    # Rows by their numbers: taking one out would count a reference to them.
    a, b = (j, i) if rows[i, AREA] > rows[j, AREA] else (i, j)
    nx, ny, nz = rows[b, NX], rows[b, NY], rows[b, NZ]
    mx, my, mz = rows[a, NX], rows[a, NY], rows[a, NZ]
    cosine = nx * mx + ny * my + nz * mz
    if cosine < 0.0:
        mx, my, mz, cosine = -mx, -my, -mz, -cosine
    if cosine < _STEEP:
        return APART, 0.0
    ex, ey, ez, fx, fy, fz = plane_axes(nx, ny, nz)
    dx, dy, dz = rows[a, CX] - rows[b, CX], rows[a, CY] - rows[b, CY], rows[a, CZ] - rows[b, CZ]
    u, v = dx * ex + dy * ey + dz * ez, dx * fx + dy * fy + dz * fz
    apart = math.sqrt(u * u + v * v)
    small, large = math.sqrt(rows[a, AREA]), math.sqrt(rows[b, AREA])
    share = MEET * min(small, apart) / (apart + 1e-12)
    # From the centroids to where they meet.
    ax, ay = -share * u, -share * v
    bx, by = u + ax, v + ay
    tx, ty = -(mx * ex + my * ey + mz * ez) / cosine, -(mx * fx + my * fy + mz * fz) / cosine
    # Height of the centroid of a over the plane of b, and of its plane where they meet.
    delta = dx * nx + dy * ny + dz * nz + ax * tx + ay * ty
    gap = max(apart - TOUCHING * (small + large), 0.0)
    drift, lean = wander
    bend = lean + drift * (_BEND_SMALL / (small + 1e-12) + _BEND_LARGE / (large + 1e-12))
    axx, axy, ayy = _slopes(rows, a, ex, ey, ez, fx, fy, fz)
    bxx, bxy, byy = _slopes(rows, b, ex, ey, ez, fx, fy, fz)
    c00 = 1.0 / rows[a, WEIGHT] + 1.0 / rows[b, WEIGHT] + drift * (PLANE_OFFSET * large + gap)
    c00 += lean * (CHORD * large) * (CHORD * large)
    c00 += ax * ax * axx + 2.0 * ax * ay * axy + ay * ay * ayy
    c00 += bx * bx * bxx + 2.0 * bx * by * bxy + by * by * byy
    c01 = ax * axx + ay * axy + bx * bxx + by * bxy
    c02 = ax * axy + ay * ayy + bx * bxy + by * byy
    c11, c12, c22 = axx + bxx + bend, axy + bxy, ayy + byy + bend
    near = determinant(c00, c01, c02, c11, c12, c22)
    discord = quadratic_form(delta, tx, ty, c00, c01, c02, c11, c12, c22) / near
    c00, c11, c22 = c00 + offset_prior, c11 + slope_prior, c22 + slope_prior
    far = determinant(c00, c01, c02, c11, c12, c22)
    return discord, 0.5 * math.log(max(far / near, 1.0))


@internal
def _slopes(rows, k, ex, ey, ez, fx, fy, fz):  # type: ignore[no-untyped-def]
    """Covariance of the slopes of a row along two axes: the inverse of the scatter along them."""
    ee, ef, ff = scatter_along(rows, k, ex, ey, ez, fx, fy, fz)
    scale = 1.0 / max(ee * ff - ef * ef, 1e-300)
    return ff * scale, -ef * scale, ee * scale


@internal
def scatter_along(rows, k, ex, ey, ez, fx, fy, fz):  # type: ignore[no-untyped-def]
    """Scatter of a row along two axes: e S e, e S f and f S f."""
    gx = rows[k, XX] * ex + rows[k, XY] * ey + rows[k, XZ] * ez
    gy = rows[k, XY] * ex + rows[k, YY] * ey + rows[k, YZ] * ez
    gz = rows[k, XZ] * ex + rows[k, YZ] * ey + rows[k, ZZ] * ez
    ee, ef = ex * gx + ey * gy + ez * gz, fx * gx + fy * gy + fz * gz
    gx = rows[k, XX] * fx + rows[k, XY] * fy + rows[k, XZ] * fz
    gy = rows[k, XY] * fx + rows[k, YY] * fy + rows[k, YZ] * fz
    gz = rows[k, XZ] * fx + rows[k, YZ] * fy + rows[k, ZZ] * fz
    return ee, ef, fx * gx + fy * gy + fz * gz


@internal
def misfit_beside(rows, k, nodes, node, white):  # type: ignore[no-untyped-def]
    """chi^2 of the points of a node about the plane of a row beside them.

    How well the plane is known there counts.
    """
    nx, ny, nz = rows[k, NX], rows[k, NY], rows[k, NZ]
    dx, dy, dz = (
        nodes[node, CX] - rows[k, CX],
        nodes[node, CY] - rows[k, CY],
        nodes[node, CZ] - rows[k, CZ],
    )
    off = nx * dx + ny * dy + nz * dz
    across = nx * (nodes[node, XX] * nx + 2.0 * (nodes[node, XY] * ny + nodes[node, XZ] * nz))
    across += ny * (nodes[node, YY] * ny + 2.0 * nodes[node, YZ] * nz) + nodes[node, ZZ] * nz * nz
    # Variance of the plane at their centroid: the patch is about as wide in all directions.
    square = dx * dx + dy * dy + dz * dz - off * off
    wide = 0.5 * (rows[k, XX] + rows[k, YY] + rows[k, ZZ])
    known = 1.0 / rows[k, WEIGHT] + square / wide
    return across + off * off / (1.0 / nodes[node, WEIGHT] + known / white)


@internal
def add_points(row, points, white, shared):  # type: ignore[no-untyped-def]
    """Add points that lie on the plane of a row: their scatter in the plane counts.

    shared: of the white variance, what all of them share.
    """
    nx, ny, nz = row[NX], row[NY], row[NZ]
    weight = points[WEIGHT] / (white * (1.0 + shared * points[COUNT]))
    dx, dy, dz = points[CX] - row[CX], points[CY] - row[CY], points[CZ] - row[CZ]
    share = weight / (row[WEIGHT] + weight)
    joint = row[WEIGHT] * share
    row[CX] += share * dx
    row[CY] += share * dy
    row[CZ] += share * dz
    off = nx * dx + ny * dy + nz * dz
    dx, dy, dz = dx - off * nx, dy - off * ny, dz - off * nz
    row[XX] += joint * dx * dx
    row[XY] += joint * dx * dy
    row[XZ] += joint * dx * dz
    row[YY] += joint * dy * dy
    row[YZ] += joint * dy * dz
    row[ZZ] += joint * dz * dz
    row[WEIGHT] += weight
    row[AREA] *= 1.0 + points[COUNT] / row[COUNT]
    row[COUNT] += points[COUNT]


@internal
def tempered(discord, count):  # type: ignore[no-untyped-def]
    """Discord with the tails of Student's t: (nu + 3) ln(1 + discord / nu), nu growing with points.

    The size of a cell's error is uncertain, so that a cell on a rounded edge costs little; an
    average over many cells is normal.
    """
    nu = 4.0 * max(1.0, count / 36.0)
    return (nu + 3.0) * math.log(1.0 + discord / nu)


@compiled
def write_normals(rows):  # type: ignore[no-untyped-def]
    """Write the normals of rows (n, 18) once more."""
    for k in range(rows.shape[0]):
        write_normal(rows[k])
