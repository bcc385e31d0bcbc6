/* main.c - the program oceanxl-lab: synthetic surveys and the studies. `oceanxl synth` executes it.
 *
 * Its commands, options and help are in the tables of cli/, together with those of oceanxl.
 */
#include "lab.h"
#include "../cli/console.h"

static oxl_result run_synth(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    synth_options options = a->synth;
    oxl_result rc;
    options.out = a->out;
    options.write_images = !a->no_images;
    options.progress = console_count;
    options.user = console;
    if (a->threads > 0) options.threads = a->threads;
    console_catch_signals();
    rc = synth_run(ctx, &options);
    console_clear(console);
    if (rc == OXL_OK) print_format(stdout, "survey    %s\n", a->out);
    return rc;
}

/* Runs studies: many trainings with the options of a job, a log and a progress line on this console. */
static oxl_result run_study(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    static const struct {
        unsigned studies;
        double budget;
    } kinds[] = {{1u << STUDY_ABLATION, 0}, {1u << STUDY_TRADEOFF, 1200}, {(1u << STUDY_ALL) - 1, 600}};
    const int kind = (int)a->command - COMMAND_ABLATE;
    const study_options o = {.survey = a->path,
                             .surveys = a->path_count,
                             .out = a->out,
                             .name = CLI_COMMANDS[a->command].name,
                             .studies = kinds[kind].studies,
                             .rows = a->rows,
                             .seeds = a->seeds,
                             .budget = a->budget > 0 ? a->budget : kinds[kind].budget,
                             .job = a->job,
                             .memory = &console->memory,
                             .callback = {console_progress, console}};
    oxl_result rc;
    console_catch_signals();
    rc = study_run(ctx, &o, stdout);
    console_clear(console);
    if (rc == OXL_ERR_INTERRUPTED)
        fputs(
            "oxl: the command was interrupted; finished trainings are kept\n     resume: run the same command again\n",
            stderr);
    return rc;
}

/* Runs a command; all write to a folder that one process at a time may use. */
static oxl_result run(oxl_context *ctx, const struct arguments *a, struct console *console)
{
    oxl_lock *lock = NULL;
    oxl_result rc = oxl_lock_folder(ctx, a->out, &lock);
    if (rc == OXL_OK) rc = (a->command == COMMAND_SYNTH ? run_synth : run_study)(ctx, a, console);
    oxl_unlock_folder(ctx, &lock);
    return rc;
}

static int refuse_others(char **argv, const struct arguments *a)
{
    char text[200];
    if (a->command >= COMMAND_SYNTH) return -1;
    snprintf(text, sizeof text, "%s is a command of oceanxl, not of oceanxl-lab\nfix: oceanxl %s", argv[1],
             argv[1]);
    console_error("", text);
    return EXIT_USAGE;
}

int main(int argc, char **argv)
{
    const struct program program = {refuse_others, run};
    return console_main(argc, argv, &program);
}
