/* synth_options.c - what a synthetic survey is like without options: the help of both programs states it. */
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
