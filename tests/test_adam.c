/* test_adam.c - which rows a step of the optimiser changes. Its formulas: test_reference.c, test_extremes.c. */
#include "test.h"

enum { ADAM_ROWS = 2 * PACK };

struct adam_state {
    float parameter[ADAM_ROWS], mean[ADAM_ROWS], square[ADAM_ROWS], gradient[ADAM_ROWS];
};

static struct adam_state adam_begin(void)
{
    struct adam_state s;
    for (int i = 0; i < ADAM_ROWS; i++) s.parameter[i] = s.gradient[i] = 1, s.mean[i] = s.square[i] = 0.5f;
    return s;
}

/* The first step changes the rows of these bits and no others. */
static void adam_check_step(struct adam_state *s, uint16_t visible[2], uint32_t moved)
{
    struct adam_job job = {.end_pack = 2,
                           .visible = visible,
                           .planes = 1,
                           .parameter = {s->parameter},
                           .mean = {s->mean},
                           .square = {s->square},
                           .gradient = {s->gradient},
                           .rate = {0.1f},
                           .beta1 = 0.9f,
                           .beta2 = 0.999f,
                           .inverse_correction = 31.6f};
    adam_step(test_ctx->isa, &job);
    for (int i = 0; i < ADAM_ROWS; i++) {
        const int is_moved = moved >> i & 1;
        CHECK((s->mean[i] != 0.5f) == is_moved && (s->square[i] != 0.5f) == is_moved);
        if (isfinite(s->parameter[i])) CHECK((s->parameter[i] != 1) == is_moved);
    }
}

TEST(adam_does_not_change_rows_out_of_view)
{
    uint16_t some[2] = {0x00F0, 0};
    struct adam_state s = adam_begin();
    adam_check_step(&s, some, 0x00F0);
}

TEST(adam_skips_nonfinite_rows_and_steps_their_neighbours)
{
    uint16_t all[2] = {0xFFFF, 0xFFFF};
    struct adam_state s = adam_begin();
    s.gradient[3] = NAN;
    s.gradient[20] = -INFINITY;
    s.parameter[21] = NAN;
    adam_check_step(&s, all, ~(1u << 3 | 3u << 20));
    CHECK(all[0] == (uint16_t) ~(1u << 3) && all[1] == (uint16_t) ~(3u << 4));
}
