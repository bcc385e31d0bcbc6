/* test_adam.c - which rows a step of the optimiser changes. Its formulas: test_reference.c, test_extremes.c; rows that
 * are not finite: test_train_nonfinite.c. */
#include "test.h"

TEST(adam_does_not_change_rows_out_of_view)
{
    uint16_t some = 0x00F0;
    float parameter[PACK], mean[PACK], square[PACK], gradient[PACK];
    struct adam_job job = {.end_pack = 1,
                           .visible = &some,
                           .planes = 1,
                           .parameter = {parameter},
                           .mean = {mean},
                           .square = {square},
                           .gradient = {gradient},
                           .rate = {0.1f},
                           .beta1 = 0.9f,
                           .beta2 = 0.999f,
                           .inverse_correction = 31.6f};
    for (int i = 0; i < PACK; i++) parameter[i] = gradient[i] = 1, mean[i] = square[i] = 0.5f;
    adam_step(test_ctx->isa, &job);
    for (int i = 0; i < PACK; i++) {
        const int is_seen = i >= 4 && i < 8;
        CHECK((parameter[i] != 1) == is_seen && (mean[i] != 0.5f) == is_seen &&
              (square[i] != 0.5f) == is_seen);
    }
}
