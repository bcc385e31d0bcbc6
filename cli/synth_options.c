/* synth_options.c - sets the defaults of a synthetic survey. They are not in lab/, because the help of
 * both programs states them. */
#include "cli.h"

synth_options synth_options_default(void)
{
    return (synth_options){.views = 40,
                           .width = 400,
                           .height = 260,
                           .water = SYNTH_1C,
                           .lamp = -1,
                           .sand_contrast = 1,
                           .noise = 1.5,
                           .seed = 1,
                           .write_images = 1};
}
