/* medium.glsl - what lies between the camera and a Gaussian: the counterpart of src/render/medium.h. Needs geometry.glsl. */
struct Medium {
    float range;
    vec3  way, through, rest; /* way: from the eye to the centre */
};

vec3 view_attenuation() { return vec3(view.attenuation[0], view.attenuation[1], view.attenuation[2]); }
vec3 view_backscatter() { return vec3(view.backscatter[0], view.backscatter[1], view.backscatter[2]); }
vec3 view_veil() { return vec3(view.veiling_light[0], view.veiling_light[1], view.veiling_light[2]); }
vec3 exp_of(vec3 x) { return vec3(own_exp(x.x), own_exp(x.y), own_exp(x.z)); }

/* training_range: 0 of the surroundings, whose colours have none. */
Medium medium_of(uint i, float training_range)
{
    Medium m;
    m.way      = vec3(at(MEAN, i), at(MEAN + 1u, i), at(MEAN + 2u, i)) - vec3(view.eye[0], view.eye[1], view.eye[2]);
    m.range    = sqrt(dot(m.way, m.way));
    m.through  = exp_of(-view_attenuation() * (m.range - training_range));
    m.rest     = exp_of(-view_backscatter() * m.range);
    return m;
}

vec3 medium_forward(Medium m, vec3 clear) { return clear * m.through + view_veil() * (vec3(1.0) - m.rest); }

/* light: dL/dc'. dmean: dL/d(centre) through the range. Returns dL/dJ, without the clamp of J. */
vec3 medium_backward(Medium m, vec3 clear, vec3 light, out vec3 dmean)
{
    float inverse = m.range > 0.0 ? 1.0 / m.range : 0.0;
    vec3  direct  = light * clear * m.through;
    float dr      = dot(light * view_veil() * view_backscatter(), m.rest) - dot(view_attenuation(), direct);
    dmean         = dr * inverse * m.way;
    return light * m.through;
}
