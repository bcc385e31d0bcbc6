/* arguments.c - parses the command line into a command, paths and options, by the tables of options.c.
 *
 * Invariant: the options of the job are applied in the table's order, whatever the command line's, so that
 * the preset, which is first there, does not overwrite the others.
 */
#include "cli.h"

#include <stdarg.h>
#include <string.h>

/* ---------------- names */

/* Keeps `name` as the best suggestion for `word` if it begins as the word does for longer than the best so far. */
static void suggest(const char *word, const char *name, char best[40], int *most)
{
    int same = 0;
    while (word[same] && (word[same] == name[same] || (word[same] == '_' && name[same] == '-'))) same++;
    if (same <= *most) return;
    *most = same;
    snprintf(best, 40, "%s", name);
}

/* Writes the message to a->error and returns 1, so that a caller can return its result. */
static int fail(struct arguments *a, const char *format, ...)
{
    va_list list;
    va_start(list, format);
    vsnprintf(a->error, sizeof a->error, format, list);
    va_end(list);
    return 1;
}

static int fail_unknown(struct arguments *a, const char *what, const char *word, const char *best)
{
    const char *command = a->command ? CLI_COMMANDS[a->command].name : "";
    return fail(a, "%s '%s' is not known%s%s%s\nfix: oceanxl %s%s--help%s lists them", what, word,
                best[0] ? "; did you mean " : "", best, best[0] ? "?" : "", command, command[0] ? " " : "",
                command[0] ? " all" : "");
}

/* Options of other trainers, and what they are called here. */
static const char *const OTHER_NAMES[][2] = {
    {"-s --source_path --data --data_dir --data-dir --input", "SCENE, the first word after the command"},
    {"-m --model_path --output --output-dir --output_path --result_dir --export-path", "-o FOLDER"},
    {"-n --num-iters --max-num-iterations --max_steps --total-steps --steps", "--iterations N"},
    {"-r -d --resolution --data_factor --downscale-factor --max-resolution",
     "--max-side PX, the longer side"},
    {"-i", "--images FOLDER"},
    {"--eval", "--test-every 8, the default"},
    {"--data_device --cache-images", "--ram SIZE, which limits the cache of images"},
    {"-w --white_background", "--background 1,1,1"},
    {"--max-cap --cap-max --cap_max --max-splats", "--max-gaussians N"},
    {"--checkpoint --start_checkpoint --load-checkpoint --resume", "the same command again, which resumes"},
};

/* Refuses the name of an option that another trainer has; 0: it is none. */
static int fail_other(struct arguments *a, const char *word)
{
    const size_t length = strlen(word);
    for (size_t i = 0; i < sizeof OTHER_NAMES / sizeof *OTHER_NAMES; i++)
        for (const char *at = OTHER_NAMES[i][0]; (at = strstr(at, word)) != NULL; at += length)
            if ((at == OTHER_NAMES[i][0] || at[-1] == ' ') && (at[length] == ' ' || !at[length]))
                return fail(a, "option '%s' belongs to another program\nfix: use %s", word,
                            OTHER_NAMES[i][1]);
    return 0;
}

/* Refuses a word that is no option, with the nearest name; word: as typed, without a value. */
static int unknown_option(const char *word, struct arguments *a)
{
    char other[40], best[40] = "";
    int most = 4; /* letters, of which two may be dashes */
    if (a->command == COMMAND_ABLATE && cli_is_study_variable(word + strspn(word, "-")))
        return fail(
            a,
            "option '%s': each row of ablate sets it itself\nfix: choose the rows, as --rows 3dgs,v2,oceanxl",
            word);
    if (fail_other(a, word)) return 1;
    for (int i = 0; i < cli_option_count(); i++)
        if (cli_option_is_of(i, a->command))
            suggest(word, cli_option_word(cli_option_at(i), other), best, &most);
    return fail_unknown(a, "option", word, best);
}

static int find_command(const char *word, struct arguments *a)
{
    char best[40] = "";
    int most = 1;
    for (enum command c = COMMAND_TRAIN; c < COMMANDS; c++) {
        if (strcmp(word, CLI_COMMANDS[c].name) == 0) a->command = c;
        suggest(word, CLI_COMMANDS[c].name, best, &most);
    }
    return a->command ? 0 : fail_unknown(a, "command", word, best);
}

/* ---------------- parsing */

/* Finds the option of the command that `word` names, or returns -1. */
static int find_option(const char *word, struct arguments *a)
{
    char name[40];
    for (int i = 0; i < cli_option_count(); i++) {
        if (!cli_option_is_of(i, a->command)) continue;
        if (strcmp(word, cli_option_word(cli_option_at(i), name)) == 0) return i;
    }
    return -1;
}

static int parse_help(int argc, char **argv, int *at, struct arguments *a)
{
    a->help = "";
    if (*at + 1 < argc && strcmp(argv[*at + 1], "all") == 0) a->help = argv[++*at];
    return 0;
}

/* Parses one option at argv[*at], as "--name value" or "--name=value". Tries a value of the job on a copy,
 * and keeps its text: arguments_apply sets all of them in the table's order. */
static int parse_option(int argc, char **argv, int *at, struct arguments *a)
{
    const char *value = strchr(argv[*at], '=');
    const oxl_option *o;
    oxl_job_options tried = a->job;
    char word[40];
    int index;
    snprintf(word, sizeof word, "%.*s", (int)(value ? value - argv[*at] : 39), argv[*at]);
    if (value) value++;
    if (strcmp(word, "--help") == 0 || strcmp(word, "-h") == 0) return parse_help(argc, argv, at, a);
    index = find_option(word, a);
    if (index < 0) return unknown_option(word, a);
    o = cli_option_at(index);
    if (!value && o->kind != OXL_OPTION_FLAG && *at + 1 < argc) value = argv[++*at];
    if (o->kind == OXL_OPTION_FLAG ? value != NULL : value == NULL)
        return fail(a, "option %s takes %s%s\nfix: oceanxl %s --help all shows it", word,
                    o->value ? "a value: " : "no value", o->value ? o->value : "",
                    CLI_COMMANDS[a->command].name);
    if (cli_option_of_job(index) < 0) return oxl_option_set(o, a, value, a->error, sizeof a->error) != OXL_OK;
    a->given[cli_option_of_job(index)] = value ? value : "true";
    return oxl_option_set(o, &tried, value, a->error, sizeof a->error) != OXL_OK;
}

/* Refuses an output folder that has the name of a model or an image, as other programs write these. */
static int check_out(struct arguments *a)
{
    static const char *const files[] = {".ply", ".spz", ".splat", ".glb", ".png", ".jpg", ".tif"};
    const size_t length = a->out ? strlen(a->out) : 0;
    for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
        const size_t n = strlen(files[i]);
        if (length > n && !strcmp(a->out + length - n, files[i]))
            return fail(a,
                        "-o %s is the name of a file, but the command writes a folder, which holds %s\nfix: "
                        "-o %.*s",
                        a->out, a->command == COMMAND_TRAIN ? "scene.ply" : "the files", (int)(length - n),
                        a->out);
    }
    return 0;
}

static int check_complete(struct arguments *a)
{
    const struct cli_command *c = &CLI_COMMANDS[a->command];
    if (a->ortho && a->flight)
        return fail(a, "--ortho and --flight exclude each other\nfix: use one of the two");
    if (a->command == COMMAND_RENDER && !a->ortho && (a->epsg || a->frame || a->gps))
        return fail(a, "--%s applies to --ortho only\nfix: add --ortho, or leave the option out",
                    a->epsg  ? "epsg"
                    : a->gps ? "gps"
                             : "frame");
    if (a->devices || ((a->path_count == c->paths || (a->path_count > 0 && a->command == COMMAND_RESULTS)) &&
                       (!c->needs_out || a->out)))
        return a->command == COMMAND_TRAIN || a->command == COMMAND_RENDER ? check_out(a) : 0;
    return fail(a, "oceanxl %s needs %s\nfix: for example: %s", c->name, c->usage, c->example);
}

void arguments_apply(const struct arguments *a, oxl_job_options *o)
{
    for (int i = 0; i < oxl_option_count(); i++)
        if (a->given[i]) oxl_option_set(oxl_option_at(i), o, a->given[i], NULL, 0);
}

/* Reads the options that stand in place of a command. */
static void parse_first(int argc, char **argv, struct arguments *a)
{
    int at = 1;
    if (argc < 2) return;
    a->version = strcmp(argv[1], "--version") == 0 || strcmp(argv[1], "-V") == 0;
    a->manual = strcmp(argv[1], "--man") == 0;
    a->page = strcmp(argv[1], "--options-page") == 0;
    if (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0 || strcmp(argv[1], "help") == 0)
        parse_help(argc, argv, &at, a);
}

int arguments_parse(int argc, char **argv, struct arguments *a)
{
    int ended = 0;
    *a = arguments_default();
    parse_first(argc, argv, a);
    if (a->version || a->help || a->manual || a->page) return 0;
    if (argc < 2) return fail(a, "a command is expected\nfix: oceanxl --help lists them");
    if (find_command(argv[1], a)) return 1;
    for (int i = 2; i < argc; i++) {
        if (!ended && strcmp(argv[i], "--") == 0) ended = 1; /* paths that follow may begin with a dash */
        else if (!ended && argv[i][0] == '-' && argv[i][1]) {
            if (parse_option(argc, argv, &i, a)) return 1;
        } else if (a->path_count < (a->command == COMMAND_RESULTS ? CLI_PATHS : 2))
            a->path[a->path_count++] = argv[i];
        else
            return fail(a, "'%s' is one argument too many\nfix: oceanxl %s --help shows an example", argv[i],
                        CLI_COMMANDS[a->command].name);
    }
    arguments_apply(a, &a->job);
    return a->help ? 0 : check_complete(a);
}
