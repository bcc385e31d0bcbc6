/* loss_forward.comp - |x - y|, SSIM and its derivatives, not yet divided by how many count. VARIANT 1: by a lamp. */
#version 450
#include "common.glsl"
#include "loss.glsl"

layout(std430, binding = 0) readonly buffer Rgb { float rgb[]; };       /* (3,H,W) drawn */
layout(std430, binding = 1) readonly buffer Target { float target[]; }; /* (3,H,W) training image */
layout(std430, binding = 2) readonly buffer Weight { float weight[]; }; /* (H,W), read when masked */
layout(std430, binding = 3) writeonly buffer Slope0 { float slope0[]; }; /* by channel: (3,H,W) of SSIM in the blurred x, x^2 + y^2, */
layout(std430, binding = 4) writeonly buffer Slope1 { float slope1[]; }; /* xy; apart, as no array is to be larger than an image */
layout(std430, binding = 5) writeonly buffer Slope2 { float slope2[]; };
layout(std430, binding = 6) writeonly buffer Partial { float partial[]; }; /* (3,tiles,5) see loss_total.comp */
layout(std430, binding = 7) readonly buffer Lamp { float lamp[]; };     /* (H,W) the lamp's gain, VARIANT 1 */

shared float x[REACH * REACH], y[REACH * REACH];
const uint ALONG = REACH * 16u;
shared float along[4 * REACH * 16]; /* (4, ALONG); later the sums, (5,256): some devices have no more than 16384 bytes */

/* Whether the whole window of the invocation's pixel counts; leaves x as scratch. */
bool whole_window(uint i, ivec2 origin)
{
    if (push.masked == 0u) return true;
    for (uint k = i; k < REACH * REACH; k += 256u) {
        ivec2 p = origin + ivec2(k % REACH, k / REACH);
        x[k]    = in_image(p) ? (weight[pixel_index(p)] > 0.0 ? 1.0 : 0.0) : 1.0;
    }
    barrier();
    for (uint k = i; k < REACH * 16u; k += 256u) {
        float all_ = 1.0;
        for (uint d = 0u; d < 11u; d++) all_ *= x[k / 16u * REACH + k % 16u + d];
        along[k] = all_;
    }
    barrier();
    float all_ = 1.0;
    for (uint d = 0u; d < 11u; d++) all_ *= along[(i / 16u + d) * 16u + i % 16u];
    barrier();
    return all_ > 0.0;
}

void blur(uint i, out float m[4])
{
    for (uint k = i; k < REACH * 16u; k += 256u) {
        float s[4] = float[](0.0, 0.0, 0.0, 0.0);
        for (uint d = 0u; d < 11u; d++) {
            float a = x[k / 16u * REACH + k % 16u + d], b = y[k / 16u * REACH + k % 16u + d];
            s[0] = fma(WINDOW[d], a, s[0]);
            s[1] = fma(WINDOW[d], b, s[1]);
            s[2] = fma(WINDOW[d], fma(a, a, b * b), s[2]);
            s[3] = fma(WINDOW[d], a * b, s[3]);
        }
        for (uint map = 0u; map < 4u; map++) along[map * ALONG + k] = s[map];
    }
    barrier();
    for (uint map = 0u; map < 4u; map++) {
        m[map] = 0.0;
        for (uint d = 0u; d < 11u; d++) m[map] = fma(WINDOW[d], along[map * ALONG + (i / 16u + d) * 16u + i % 16u], m[map]);
    }
}

/* Wang et al. 2004; the derivatives as in loss_differentiate of src/render/loss.c. */
float ssim_of(float m[4], out vec3 d)
{
    float ux = m[0], uy = m[1], uu = fma(ux, ux, uy * uy), uxy = ux * uy;
    float a1 = fma(2.0, uxy, 1e-4), a2 = fma(2.0, m[3] - uxy, push.contrast), b1 = uu + 1e-4, b2 = m[2] - uu + push.contrast;
    float i = 1.0 / (b1 * b2), p = a1 * i, q = a2 * i, ssim = a1 * q, t = ssim * i;
    d = -2.0 * vec3(uy * (q - p) - ux * t * (b2 - b1), -0.5 * t * b1, p);
    return ssim;
}

void slope_put(uint channel, uint at, float value)
{
    if (channel == 0u) slope0[at] = value;
    else if (channel == 1u) slope1[at] = value;
    else slope2[at] = value;
}

void main()
{
    uint i = gl_LocalInvocationIndex, channel = loss_channel(), plane = push.width * push.height;
    if (channel >= 3u) return;
    ivec2 origin = reach_at(), at = origin + ivec2(i % 16u, i / 16u) + int(HALF);
    bool  inside = in_image(at), counts = whole_window(i, origin) && inside;
    for (uint k = i; k < REACH * REACH; k += 256u) {
        ivec2 p = origin + ivec2(k % REACH, k / REACH);
        bool  in_ = in_image(p);
        x[k] = in_ ? loss_gain(channel) * rgb[channel * plane + pixel_index(p)] : 0.0;
        if (VARIANT == 1u && in_) x[k] *= lamp[pixel_index(p)];
        y[k] = in_ ? target[channel * plane + pixel_index(p)] : 0.0;
    }
    barrier();
    uint  centre = (i / 16u + HALF) * REACH + i % 16u + HALF;
    float difference = x[centre] - y[centre], ssim = 0.0, m[4];
    float w = inside ? (push.masked != 0u ? weight[pixel_index(at)] : 1.0) : 0.0;
    vec3  d = vec3(0.0);
    if (push.ssim_weight > 0.0) {
        blur(i, m);
        ssim = ssim_of(m, d);
        for (uint k = 0u; k < 3u && inside; k++) slope_put(channel, k * plane + pixel_index(at), counts ? d[k] : 0.0);
    }
    barrier(); /* `along` is not read any more */
    along[0 + i] = w * abs(difference);
    along[256 + i] = counts ? ssim : 0.0;
    along[512 + i] = w * difference * difference;
    along[768 + i] = w > 0.0 ? 1.0 : 0.0;
    along[1024 + i] = counts ? 1.0 : 0.0;
    for (uint half_ = 128u; half_ > 0u; half_ /= 2u) {
        barrier();
        for (uint k = 0u; k < 5u && i < half_; k++) along[256u * k + i] += along[256u * k + i + half_];
    }
    if (i == 0u)
        for (uint k = 0u; k < 5u; k++) partial[work_group() * 5u + k] = along[256u * k];
}
