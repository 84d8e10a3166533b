/* The blocks in one precision: REAL is the type, NAME(x) the name with its suffix. Included once for each. */

/* Strains beyond this are cut, so that energies of any finite strain are finite. */
static const REAL NAME(limit) = (REAL)1e14;

static REAL NAME(cut)(REAL value) {
    return value > NAME(limit) ? NAME(limit) : value < -NAME(limit) ? -NAME(limit) : value;
}

/* Slope of the cut strain: where a component is cut, the energy does not change with it, and it has no stress. */
static REAL NAME(slope)(REAL value) {
    return value > NAME(limit) || value < -NAME(limit) ? (REAL)0 : (REAL)1;
}

static int32_t NAME(membrane)(const void *material, NAME(caphy_membrane) * block, caphy_sink error) {
    (void)error;
    const woven *w = material;
    const REAL k0 = (REAL)w->values[K0], k1 = (REAL)w->values[K1], k2 = (REAL)w->values[K2], k3 = (REAL)w->values[K3];
    const REAL constants[4] = {k0, k1, k2, k3};
    const REAL tangent[9] = {k0, k1, 0, k1, k2, 0, 0, 0, k3};
    const size_t n = block->count;
    for (size_t i = 0; i < n; i++) {
        const REAL *g = block->green.data;
        const REAL u = NAME(cut)(g[i]), v = NAME(cut)(g[n + i]), s = NAME(cut)(g[2 * n + i]);
        const REAL slope[3] = {NAME(slope)(g[i]), NAME(slope)(g[n + i]), NAME(slope)(g[2 * n + i])};
        if (block->energy.data) {
            block->energy.data[i] = (REAL)0.5 * (k0 * u * u + k2 * v * v) + k1 * u * v + k3 * s * s;
        }
        if (block->stress.data) {
            block->stress.data[i] = slope[0] * (k0 * u + k1 * v);
            block->stress.data[n + i] = slope[1] * (k2 * v + k1 * u);
            block->stress.data[2 * n + i] = slope[2] * k3 * s;
        }
        for (size_t e = 0; e < 9; e++) {
            const REAL t = slope[e / 3] * slope[e % 3] * tangent[e];
            if (block->tangent_held.data) block->tangent_held.data[e * n + i] = t;
            if (block->tangent_total.data) block->tangent_total.data[e * n + i] = t;
        }
        for (size_t a = 0; a < 4; a++) {
            if (block->stiffness.data) block->stiffness.data[a * n + i] = constants[a];
        }
    }
    return CAPHY_OK;
}

/* Share of a fold's direction along u; a direction of no length folds along v. */
static REAL NAME(along_u)(const REAL *direction, size_t n, size_t i) {
    const REAL u = direction[i] * direction[i], v = direction[n + i] * direction[n + i];
    return u / (u + v + (REAL)1e-30);
}

static int32_t NAME(hinge)(const void *material, NAME(caphy_hinge) * block, caphy_sink error) {
    (void)error;
    const woven *w = material;
    const REAL bend_u = (REAL)w->values[BEND_U], bend_v = (REAL)w->values[BEND_V];
    const size_t n = block->count;
    for (size_t i = 0; i < n; i++) {
        if (block->stiffness.data) {
            const REAL a = bend_v + (bend_u - bend_v) * NAME(along_u)(block->direction0.data, n, i);
            const REAL b = bend_v + (bend_u - bend_v) * NAME(along_u)(block->direction1.data, n, i);
            block->stiffness.data[i] = (a + b) * (REAL)0.5;
        }
        if (block->stiffness_by_angle.data) block->stiffness_by_angle.data[i] = 0;
        if (block->stiffness_by_length.data) block->stiffness_by_length.data[i] = 0;
    }
    return CAPHY_OK;
}
