/* test_train_selection.c - decisions within a run: depth weights. */
#include "test.h"

TEST(selection_corrects_depth_weights_within_the_run_and_a_stopped_run_ends_in_the_same_bytes)
{
    NEEDS_PART(ucd);
    OWNED_CHECKPOINT_CASE c = checkpoint_of(train_scene(14), train_options(240));
    c.options.sh_degree = 0;
    c.options.densify_every = 3; /* 21 densifications from step 60 to 120 */
    c.options.densify_gradient = 8e-3f;
    c.options.ucd = OXL_UCD_SEARCH;
    checkpoint_check_stops(&c, (const int[]){60, 62, 64, 90, 119, 200, 0});
    CHECK(strstr(c.decisions.data, ", corrected by 2 pairs of costs\"") != NULL);
    CHECK(!strstr(c.decisions.data, "f_mid 1.50") || !strstr(c.decisions.data, "f_far 2.00"));
}
