/* test_train_selection.c - decisions within a run: depth weights. */
#include "test.h"

/* A run stopped at each of these steps and resumed ends in the bytes of an uninterrupted one. Its decisions
 * are left. */
static void selection_test_check_stops(struct checkpoint_case *c, const int *stops, size_t count)
{
    OWNED_MODEL model = {0};
    c->whole = test_trained(c->scene, &c->options);
    for (size_t i = 0; i < count; i++) {
        CHECK(checkpoint_run(c, "key", stops[i], &model) == OXL_ERR_INTERRUPTED);
        oxl_model_free(test_ctx, &model);
    }
    text_free(&c->decisions);
    CHECK_OK(checkpoint_run(c, "key", -1, &model));
    CHECK(test_same_model(&model, &c->whole) && model.lobes == c->whole.lobes);
}

TEST(selection_corrects_depth_weights_within_the_run_and_a_stopped_run_ends_in_the_same_bytes)
{
    NEEDS_PART(ucd);
    static const int stops[] = {60, 62, 64, 90, 119, 200};
    OWNED_CHECKPOINT_CASE c = checkpoint_of(train_scene(14), train_options(240));
    c.options.sh_degree = 0;
    c.options.densify_every = 3; /* 21 densifications from step 60 to 120 */
    c.options.densify_gradient = 8e-3f;
    c.options.ucd = OXL_UCD_SEARCH;
    selection_test_check_stops(&c, stops, OXL_COUNT(stops));
    CHECK(strstr(c.decisions.data, ", corrected by 2 pairs of costs\"") != NULL);
    CHECK(!strstr(c.decisions.data, "f_mid 1.50") || !strstr(c.decisions.data, "f_far 2.00"));
}
