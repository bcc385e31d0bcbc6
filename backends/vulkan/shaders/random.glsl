/* random.glsl - the numbers of src/core/random.h: 64 bits as two words, the lower one first. */
uvec2 multiply64(uvec2 a, uvec2 b)
{
    uint high, low;
    umulExtended(a.x, b.x, high, low);
    return uvec2(low, high + a.x * b.y + a.y * b.x);
}

uvec2 shift_xor(uvec2 x, uint by) { return x ^ uvec2(x.x >> by | x.y << (32u - by), x.y >> by); }

uvec2 random_mix(uvec2 x)
{
    uint carry;
    uint low = uaddCarry(x.x, 0x7F4A7C15u, carry);
    x        = uvec2(low, x.y + 0x9E3779B9u + carry);
    x        = multiply64(shift_xor(x, 30u), uvec2(0x1CE4E5B9u, 0xBF58476Du));
    x        = multiply64(shift_xor(x, 27u), uvec2(0x133111EBu, 0x94D049BBu));
    return shift_xor(x, 31u);
}

/* mixed: random_mix of the seed. */
uvec2 random_bits(uvec2 mixed, uint a, uint b) { return random_mix(random_mix(mixed ^ uvec2(a, 0u)) ^ uvec2(b, 0u)); }
