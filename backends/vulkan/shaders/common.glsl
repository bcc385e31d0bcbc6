/* common.glsl - what the shaders share: constants, arithmetic, numbering of work. Their CPU counterparts are in src/render/kernels.h.
 *
 * 256 invocations a workgroup, or GROUP. Nothing depends on the size of a subgroup. More than 65535 workgroups are dispatched in two
 * dimensions, so a shader calls work_group() for its index.
 */
#extension GL_GOOGLE_include_directive : require

#ifndef GROUP
#define GROUP 256
#endif
layout(local_size_x = GROUP) in;
layout(constant_id = 0) const uint VARIANT = 0u; /* what each shader takes it for */

const uint  TILE              = 16u;
const float ALPHA_MAX         = 0.99;
const float TRANSMITTANCE_MIN = 1e-4;
const float TRANSMITTANCE_MAX = 16.0;
const float LOW_PASS          = 0.3;
const float ANTIALIAS_LOW_PASS = 0.1;
const float ANTIALIAS_MIN     = 2.5e-5; /* least ratio of determinants: see src/render/kernels.h */
const float LOG2_E            = 1.4426950408889634;
const float LN_2              = 0.6931471805599453;

/* Words of the buffer of counts (resident.h, enum vulkan_count). A training step that cannot be done sets HALT: then neither it nor any
 * after it changes the model, what was seen of it or the statistics, until the host has looked. */
const uint VISIBLE = 0u, PAIRS = 1u, PAIRS_FOUND = 2u, HALT = 3u, NONFINITE = 4u, FIRST_NONFINITE = 5u, CLEARED = 6u;
const uint HALT_PAIRS = 1u, HALT_LOSS = 2u; /* more pairs than there is room for; a loss that is not finite */

uint work_group() { return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x; }
uint work_item() { return work_group() * 256u + gl_LocalInvocationIndex; }

/* By their bits: a device need not keep NaN in comparisons, in min, max and clamp least of all. It may also flush denormal numbers
 * to 0, so nothing here depends on one. Compilers that assume numbers to be finite recognize this test too, and leave it out, where they know
 * the constant: shaders that test what they computed get it from the host, as INFINITY_BITS. */
#ifndef INFINITY_BITS
#define INFINITY_BITS 0x7F800000u
#endif
bool is_finite(float x) { return (floatBitsToUint(x) & INFINITY_BITS) != INFINITY_BITS; }
bool is_nan(float x) { return (floatBitsToUint(x) & 0x7FFFFFFFu) > INFINITY_BITS; }

/* 2^x for -126 <= x <= 127; anything outside. The polynomial of src/render/real.h: GLSL's own exp2 has no bound that all devices keep. */
float own_exp2(float x)
{
    precise float n = floor(x + 0.5), f = x - n;
    precise float p = 0.00132647273;
    p               = fma(p, f, 0.00967151277);
    p               = fma(p, f, 0.0555073374);
    p               = fma(p, f, 0.240222421);
    p               = fma(p, f, 0.693146978);
    p               = fma(p, f, 1.0);
    return intBitsToFloat(floatBitsToInt(p) + (int(clamp(n, -200.0, 200.0)) << 23));
}

/* e^x, clamped to the range of normal numbers. */
float own_exp(float x)
{
    precise float inside = clamp(x, -87.0, 88.0);
    precise float n      = floor(inside * 1.44269502 + 0.5);
    precise float f      = fma(inside, 1.92596299e-8, fma(inside, 1.44269502, -n));
    precise float p      = own_exp2(f);
    return is_nan(x) ? x : intBitsToFloat(floatBitsToInt(p) + (int(n) << 23));
}

/* log2 x for normal x > 0; of NaN and infinity about 128, whatever the sign, as on the CPU: so that such a row is visible and reported. */
float own_log2(float x)
{
    int           bits     = floatBitsToInt(x) & 0x7FFFFFFF;
    int           exponent = (bits - 0x3F3504F3) >> 23;
    precise float m        = intBitsToFloat(bits - (exponent << 23)) - 1.0;
    precise float p        = 0.125837037;
    p                      = fma(p, m, -0.207269816);
    p                      = fma(p, m, 0.215715631);
    p                      = fma(p, m, -0.238944814);
    p                      = fma(p, m, 0.287916245);
    p                      = fma(p, m, -0.360703683);
    p                      = fma(p, m, 0.480910643);
    p                      = fma(p, m, -0.721347347);
    p                      = fma(p, m, 1.442695);
    return fma(p, m, float(exponent));
}

float own_sigmoid(float x)
{
    float e = own_exp(-abs(x)), s = 1.0 / (1.0 + e);
    return is_nan(x) ? x : x >= 0.0 ? s : e * s;
}
