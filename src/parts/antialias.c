/* antialias.c - renders so that the model looks alike at every size: zoomed out it does not swell, zoomed in
 * it has no spikes.
 *
 * The low pass that keeps splats at least a pixel wide also makes them brighter than they are, and training
 * compensates for that at the size of its images alone. With this part the opacity falls as the splat is
 * widened, so that its energy stays [Yu 2024, eq. 9].
 */
#include "../train/part.h"
#include "../core/option_rows.h"

static oxl_result antialias_begin(struct train *t, void *state)
{
    (void)state;
    t->trained.model.antialias = t->options->antialias;
    return OXL_OK;
}

/* clang-format off */
static const oxl_option antialias_options[] = {
{"antialias", "off|on", OXL_OPTION_CHOICE, OPTION_AT(train.antialias), 0, 1, PRESETS("on", "on", "off"), OXL_TIER_ADVANCED, TRAINING | RESULT, "Scene content", "keep a splat's light the same at every image size, which gains 2 to 8 dB at half and twice the training size"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_antialias = {
    .name = "antialias", .option = antialias_options, .begin = antialias_begin};
