/* geometry.glsl - a Gaussian on the image plane: the counterpart of src/render/project.c's struct project_geometry and of what makes it.
 *
 * Needs `view` and the planes of a slab: plane k of row i is at parameter[k * stride + i].
 */
#define MEAN      0u
#define LOG_SCALE 3u
#define ROTATION  6u
#define OPACITY   10u
#define SH        11u

struct Geometry {
    vec3  p, scale;
    mat3  rotation; /* rotation[k]: row k */
    vec4  q;        /* w x y z */
    float inverse_norm, tx, ty;
    bool  free_x, free_y;
    vec3  t0, t1, b0, b1, c0;
    float shrink2, xx, xy, yy, det;
    float bare; /* determinant without the low pass */
};

float at(uint plane, uint i) { return parameter[plane * push.stride + i]; }

vec3 times(mat3 m, vec3 v) { return vec3(dot(m[0], v), dot(m[1], v), dot(m[2], v)); }
vec3 transposed_times(mat3 m, vec3 v) { return v.x * m[0] + v.y * m[1] + v.z * m[2]; }

mat3 view_rotation()
{
    return mat3(view.rotation[0], view.rotation[1], view.rotation[2], view.rotation[3], view.rotation[4], view.rotation[5],
                view.rotation[6], view.rotation[7], view.rotation[8]);
}

void geometry_rotation(vec4 raw, inout Geometry g)
{
    vec4  m     = abs(raw);
    float most  = max(max(m.x, m.y), max(m.z, m.w));
    bool  turns = most > 1.2e-38;
    float near  = most > 1.0 ? 5.421010862427522e-20 : 1.8446744073709552e19; /* 2^-64, 2^64: of 1e38 the inverse would be denormal */
    float down  = turns ? 1.0 / (most * near) : 0.0;
    vec4  s     = turns ? raw * near * down : vec4(1, 0, 0, 0);
    float n     = 1.0 / sqrt(dot(s, s));
    float a = s.x * n, b = s.y * n, c = s.z * n, d = s.w * n;
    g.q            = vec4(a, b, c, d);
    g.inverse_norm = down * n * near;
    g.rotation     = mat3(1.0 - 2.0 * (c * c + d * d), 2.0 * (b * c - a * d), 2.0 * (b * d + a * c), 2.0 * (b * c + a * d),
                          1.0 - 2.0 * (b * b + d * d), 2.0 * (c * d - a * b), 2.0 * (b * d - a * c), 2.0 * (c * d + a * b),
                          1.0 - 2.0 * (b * b + c * c));
}

void geometry_jacobian(mat3 r, inout Geometry g)
{
    float inverse = 1.0 / g.p.z, x = g.p.x * inverse, y = g.p.y * inverse;
    float cx = clamp(x, -view.limit_x, view.limit_x), cy = clamp(y, -view.limit_y, view.limit_y);
    g.free_x = x == cx;
    g.free_y = y == cy;
    g.tx     = g.p.z * cx;
    g.ty     = g.p.z * cy;
    g.t0     = view.fx * inverse * r[0] - view.fx * cx * inverse * r[2];
    g.t1     = view.fy * inverse * r[1] - view.fy * cy * inverse * r[2];
}

/* Determinant by Cauchy-Binet; scaled by the largest entry, lest it overflow: see project.c. */
void geometry_covariance(inout Geometry g)
{
    g.b0         = transposed_times(g.rotation, g.t0) * g.scale;
    g.b1         = transposed_times(g.rotation, g.t1) * g.scale;
    vec3  m      = max(abs(g.b0), abs(g.b1));
    float shrink = 1.0 / max(max(1.0, m.x), max(m.y, m.z));
    vec3  s0 = shrink * g.b0, s1 = shrink * g.b1, n = cross(s0, s1);
    g.shrink2 = shrink * shrink;
    float low = (view.antialias != 0u ? ANTIALIAS_LOW_PASS : LOW_PASS) * g.shrink2;
    g.xx      = dot(s0, s0);
    g.yy      = dot(s1, s1);
    g.xy      = dot(s0, s1);
    g.bare    = dot(n, n);
    g.det     = g.bare + low * (g.xx + g.yy) + low * low;
    g.xx += low;
    g.yy += low;
    g.c0 = (cross(s1, n) + low * s0) / (g.yy * shrink);
}

/* log2 of the factor of the opacity: see project_fade in project.c. */
float geometry_fade(Geometry g) { return view.antialias != 0u ? own_log2(max(g.bare / g.det, ANTIALIAS_MIN)) / 2.0 : 0.0; }

/* All but the covariance. */
Geometry geometry_place(uint i, out bool in_front)
{
    Geometry g;
    mat3     r = view_rotation();
    g.p        = times(r, vec3(at(MEAN, i), at(MEAN + 1u, i), at(MEAN + 2u, i))) +
          vec3(view.translation[0], view.translation[1], view.translation[2]);
    in_front = g.p.z > view.near_plane;
    g.p.z    = in_front ? g.p.z : 1.0;
    g.scale  = vec3(own_exp(at(LOG_SCALE, i)), own_exp(at(LOG_SCALE + 1u, i)), own_exp(at(LOG_SCALE + 2u, i)));
    geometry_rotation(vec4(at(ROTATION, i), at(ROTATION + 1u, i), at(ROTATION + 2u, i), at(ROTATION + 3u, i)), g);
    geometry_jacobian(r, g);
    return g;
}

/* The second lobe's scale is the row's times its own. */
vec3 geometry_lobe_scale(uint i)
{
    return vec3(own_exp(at(LOG_SCALE, i) + at(push.lobe_plane + 1u, i)), own_exp(at(LOG_SCALE + 1u, i) + at(push.lobe_plane + 2u, i)),
                own_exp(at(LOG_SCALE + 2u, i) + at(push.lobe_plane + 3u, i)));
}

/* ---------------------------------------------------------------- colour */

const float SH_0   = 0.28209479177387814;
const float SH_1   = 0.4886025119029199;
const float SH_2XY = 1.0925484305920792;
const float SH_2ZZ = 0.31539156525252005;
const float SH_2XX = 0.5462742152960396;
const float SH_3Y  = 0.5900435899266435;
const float SH_3XY = 2.890611442640554;
const float SH_3YZ = 0.4570457994644658;
const float SH_3ZZ = 0.3731763325901154;
const float SH_3XX = 1.445305721320277;

void colour_basis(uint degree, vec3 d, out float basis[16])
{
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    basis[0] = SH_0;
    if (degree > 0u) {
        basis[1] = -SH_1 * y;
        basis[2] = SH_1 * z;
        basis[3] = -SH_1 * x;
    }
    if (degree > 1u) {
        basis[4] = SH_2XY * x * y;
        basis[5] = -SH_2XY * y * z;
        basis[6] = SH_2ZZ * (2.0 * zz - xx - yy);
        basis[7] = -SH_2XY * x * z;
        basis[8] = SH_2XX * (xx - yy);
    }
    if (degree > 2u) {
        basis[9]  = -SH_3Y * y * (3.0 * xx - yy);
        basis[10] = SH_3XY * x * y * z;
        basis[11] = -SH_3YZ * y * (4.0 * zz - xx - yy);
        basis[12] = SH_3ZZ * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        basis[13] = -SH_3YZ * x * (4.0 * zz - xx - yy);
        basis[14] = SH_3XX * z * (xx - yy);
        basis[15] = -SH_3Y * x * (xx - 3.0 * yy);
    }
}

/* The unit direction from the eye; inverse: 1 / distance. */
vec3 colour_direction(uint i, out float inverse)
{
    vec3  d = vec3(at(MEAN, i), at(MEAN + 1u, i), at(MEAN + 2u, i)) - vec3(view.eye[0], view.eye[1], view.eye[2]);
    float l = sqrt(dot(d, d));
    inverse = l > 0.0 ? 1.0 / l : 0.0;
    return d * inverse;
}

vec3 colour_of(uint i, uint degree, float basis[16])
{
    vec3 sum          = vec3(0.5);
    uint coefficients = (degree + 1u) * (degree + 1u);
    for (uint k = 0u; k < coefficients; k++)
        sum += basis[k] * vec3(at(SH + 3u * k, i), at(SH + 3u * k + 1u, i), at(SH + 3u * k + 2u, i));
    return vec3(is_nan(sum.x) ? 0.0 : sum.x, is_nan(sum.y) ? 0.0 : sum.y, is_nan(sum.z) ? 0.0 : sum.z); /* as the CPU's clamp */
}
