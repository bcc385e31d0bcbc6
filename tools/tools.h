/* tools.h - the parts of the command line that are more than parse, call and print. They speak to oceanxl.h alone, and so
 * prove that it suffices; they are not in the library. One section for each file of tools/.
 */
#ifndef TOOLS_H
#define TOOLS_H

#include "../oceanxl.h"

#include <stdio.h>

/* ---------------------------------------------------------------- arguments.c: the command line's words */

enum exit_code { EXIT_DONE = 0, EXIT_FAILED = 1, EXIT_USAGE = 2, EXIT_INPUT = 3, EXIT_BUDGET = 4, EXIT_STOPPED = 130 };

enum command {
    COMMAND_NONE,
    COMMAND_TRAIN,
    COMMAND_CHECK,
    COMMAND_RENDER,
    COMMAND_EVAL,
    COMMAND_INFO,
    COMMAND_CONVERT,
    COMMAND_SYNTH
};

struct arguments { /* negative numbers and NULL: not given */
    enum command command;
    const char  *path[2]; /* SCENE, MODEL SCENE, IN OUT or FILE */
    int          path_count;
    int          help, version, quiet, json, depth;
    int          preset, split; /* enum oxl_preset, enum oxl_split */
    int          iterations, max_gaussians, sh_degree, max_side, test_every, threads;
    double       max_time;    /* s */
    double       image_cache; /* bytes */
    double       seed;
    const char  *out, *images, *sparse, *masks;
};

/* 0, or 1 with a text that says what is wrong. */
int  arguments_parse(int argc, char **argv, struct arguments *out, char *error, size_t error_size);
void arguments_help(FILE *to, enum command command); /* COMMAND_NONE: the overview */

/* ---------------------------------------------------------------- info.c: a model in numbers */

oxl_result info_print(oxl_context *ctx, FILE *to, const char *path, int json);

#endif
