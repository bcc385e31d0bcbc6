/* test_adam.c - the optimiser against Kingma & Ba's formulas in double. */
#include "test.h"

enum { ADAM_ROWS = 2 * PACK };

struct adam_state {
    float parameter[ADAM_ROWS], mean[ADAM_ROWS], square[ADAM_ROWS], gradient[ADAM_ROWS];
};

static void adam_take_step(struct adam_state *s, int step, float rate, uint16_t visible[2])
{
    struct adam_job job = {.end_pack = 2,
                           .visible = visible,
                           .planes = 1,
                           .parameter = {s->parameter},
                           .mean = {s->mean},
                           .square = {s->square},
                           .gradient = {s->gradient},
                           .rate = {(float)(rate / (1 - pow(0.9, step)))},
                           .beta1 = 0.9f,
                           .beta2 = 0.999f,
                           .inverse_correction = (float)(1 / sqrt(1 - pow(0.999, step)))};
    adam_step(test_ctx->isa, &job);
}

TEST(adam_follows_the_formulas)
{
    uint16_t all[2] = {0xFFFF, 0xFFFF};
    struct adam_state s = {{0}, {0}, {0}, {0}};
    double p[ADAM_ROWS] = {0}, m[ADAM_ROWS] = {0}, v[ADAM_ROWS] = {0};
    for (int step = 1; step <= 200; step++) {
        for (int i = 0; i < ADAM_ROWS; i++) {
            const double g = s.gradient[i] = (float)(sin(step * 0.1 + i) * (i + 1));
            m[i] = 0.9 * m[i] + 0.1 * g;
            v[i] = 0.999 * v[i] + 0.001 * g * g;
            p[i] -= 0.01 * m[i] / (1 - pow(0.9, step)) / (sqrt(v[i] / (1 - pow(0.999, step))) + 1e-15);
        }
        adam_take_step(&s, step, 0.01f, all);
    }
    for (int i = 0; i < ADAM_ROWS; i++) CHECK_CLOSE(s.parameter[i], p[i], 2e-5);
}

TEST(adam_does_not_change_rows_out_of_view)
{
    uint16_t some[2] = {0x00F0, 0};
    struct adam_state s;
    for (int i = 0; i < ADAM_ROWS; i++) s.parameter[i] = s.gradient[i] = 1, s.mean[i] = s.square[i] = 0.5f;
    adam_take_step(&s, 1, 0.01f, some);
    for (int i = 0; i < ADAM_ROWS; i++) {
        const int seen = i >= 4 && i < 8;
        CHECK((s.parameter[i] != 1) == seen);
        CHECK((s.mean[i] != 0.5f) == seen);
        CHECK((s.square[i] != 0.5f) == seen);
    }
}

TEST(adam_handles_zero_and_very_large_gradients)
{
    uint16_t all[2] = {0xFFFF, 0xFFFF};
    struct adam_state s = {{0}, {0}, {0}, {0}};
    for (int i = 0; i < ADAM_ROWS; i++) s.gradient[i] = i % 2 ? 1e20f : 0;
    for (int step = 1; step <= 50; step++) adam_take_step(&s, step, 0.01f, all);
    for (int i = 0; i < ADAM_ROWS; i++) {
        CHECK(isfinite(s.parameter[i]) && isfinite(s.mean[i]) && isfinite(s.square[i]));
        CHECK_CLOSE(s.parameter[i], i % 2 ? -0.5 : 0, 0.01);
    }
}

TEST(adam_skips_nonfinite_rows_and_steps_their_neighbours)
{
    uint16_t all[2] = {0xFFFF, 0xFFFF};
    struct adam_state s;
    for (int i = 0; i < ADAM_ROWS; i++) s.parameter[i] = s.gradient[i] = 1, s.mean[i] = s.square[i] = 0.5f;
    s.gradient[3] = NAN;
    s.gradient[20] = -INFINITY;
    s.parameter[21] = NAN;
    adam_take_step(&s, 1, 0.01f, all);
    CHECK(all[0] == (uint16_t) ~(1u << 3));
    CHECK(all[1] == (uint16_t) ~(3u << 4));
    for (int i = 0; i < ADAM_ROWS; i++) {
        const int aside = i == 3 || i == 20 || i == 21;
        CHECK((s.mean[i] == 0.5f) == aside);
        CHECK((s.square[i] == 0.5f) == aside);
        if (i != 21) CHECK((s.parameter[i] == 1) == aside);
    }
}
