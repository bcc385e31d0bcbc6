/* help.c - generates --help, the manual page, docs/OPTIONS.md from the tables of commands and options.
 *
 * Invariant: no option of a command is named here: a row of a table is sufficient.
 */
#include "cli.h"

#include <string.h>

static const char HELP_PURPOSE[] = "trains one compact 3D Gaussian Splatting model of an underwater survey,\n"
                                   "from a COLMAP model and its images, on a laptop without a GPU.\n";
static const char HELP_SCENE[] =
    "SCENE is a folder with images/ and sparse/0/ (or sparse/, or the files of a COLMAP model, text or "
    "binary), or with a\ntransforms.json, poses_bounds.npy or reconstruction.json. MODEL is a .ply, .spz "
    "or .splat file, or the folder of a run.\n";
static const char HELP_CODES[] =
    "0 done, 1 failed, 2 usage, 3 bad input, 4 over the memory limit, 130 interrupted.\n";

/* Lists what train writes to OUT. */
static const struct {
    const char *name, *what;
} HELP_OUTPUTS[] = {
    {"scene.ply",
     "the model, for most viewers. It has the SH degrees in use, and second lobes in an element of their "
     "own."},
    {"scene_standard.ply", "the model for viewers, in the 62 columns that all read; "
                           "written where scene.ply has other columns."},
    {"scene_clear.ply, imaging.txt",
     "the model without its medium or, if images differ only by gains, the model trained with gains; "
     "and the parameters of exposure, lamp, medium and poses. eval and render use both files."},
    {"metrics.json",
     "psnr, plain_psnr, cc_psnr, shown_psnr, ssim and structure of each held-out view, and their means; psnr, cc_psnr, structure and flag (misfit, exposure, no structure) of training views; gaussians, bytes, seconds, iterations, peak_rss_bytes."},
    {"run.json",
     "version, options (\"job\"), renderer (\"backend\"), the survey, decisions with evidence, log lines."},
    {"report.html", "one page: charts, map, worst views."},
    {"renders/, training_views/",
     "NAME.png and NAME.image.png of each held-out view and of the worst training views; NAME.clear.png without lamp and medium, where a medium is fitted."},
    {"blocks/KKK/", "for each block: model.ply, log.csv, block.json, checkpoint.oxl while it is trained."},
    {"blocks/coarse/", "the coarse model, from which blocks start; blocks/whole/: the merged model."},
};

enum { HELP_DEFAULT = 160, HELP_COLUMN = 31 };

/* ---------------- one option in words */

/* Writes the default in words: "8", "draft 2000, standard 3000, paper 40000", or "". */
static const char *help_default(int index, char out[HELP_DEFAULT])
{
    const oxl_option *o = cli_option_at(index);
    const struct arguments defaults = arguments_default();
    out[0] = 0;
    if (o->kind == OXL_OPTION_FLAG) return out;
    if (cli_option_of_job(index) < 0) {
        oxl_option_get(o, &defaults, out, HELP_DEFAULT);
        if (o->low > 0 && strcmp(out, "0") == 0) out[0] = 0; /* 0 means that it is not given */
    } else if (o->kind == OXL_OPTION_PRESET) snprintf(out, HELP_DEFAULT, "%s", o->preset[0]);
    else if (o->preset[0] && strcmp(o->preset[0], o->preset[1]) == 0 &&
             strcmp(o->preset[0], o->preset[2]) == 0)
        snprintf(out, HELP_DEFAULT, "%s", o->preset[0]);
    else if (o->preset[0])
        snprintf(out, HELP_DEFAULT, "draft %s, standard %s, paper %s", o->preset[0], o->preset[1],
                 o->preset[2]);
    return out;
}

/* Writes "--name VALUE". */
static const char *help_option_text(const oxl_option *o, char out[100])
{
    char word[40];
    snprintf(out, 100, "%s%s%s", cli_option_word(o, word), o->value ? " " : "", o->value ? o->value : "");
    return out;
}

static int help_is_of_group(int index, int other)
{
    return strcmp(cli_option_at(index)->group, cli_option_at(other)->group) == 0;
}

static int help_group_begins(int index)
{
    for (int i = 0; i < index; i++)
        if (help_is_of_group(i, index)) return 0;
    return 1;
}

/* ---------------- --help */

/* Prints two columns; gives a first column that is too long a line of its own. */
static void help_row(FILE *to, const char *left, const char *right, const char *standard)
{
    if (strlen(left) > HELP_COLUMN) fprintf(to, "  %s\n  %*s", left, HELP_COLUMN, "");
    else fprintf(to, "  %-*s", HELP_COLUMN, left);
    fprintf(to, " %s%s%s%s\n", right, standard[0] ? " (" : "", standard, standard[0] ? ")" : "");
}

static void help_overview(FILE *to)
{
    fprintf(to,
            "OceanXL " OXL_VERSION " %s\n  oceanxl train survey -o out\n\n"
            "Commands (oceanxl COMMAND --help describes one; oceanxl --man prints the manual page)\n",
            HELP_PURPOSE);
    for (int i = 1; i < COMMANDS; i++) {
        char left[64];
        snprintf(left, sizeof left, "%s %s", CLI_COMMANDS[i].name, CLI_COMMANDS[i].usage);
        help_row(to, left, CLI_COMMANDS[i].purpose, "");
    }
    fprintf(to, "\n%sExit codes: %s", HELP_SCENE, HELP_CODES);
}

/* Prints the options of a command, or of all commands, group by group. Returns how many it left out. */
static int help_options(FILE *to, enum command command, int all)
{
    int left_out = 0;
    for (int g = 0; g < cli_option_count(); g++)
        for (int i = g, shown = 0; i < cli_option_count() && help_group_begins(g); i++) {
            const oxl_option *o = cli_option_at(i);
            const int hidden = o->tier != OXL_TIER_BASIC && !all;
            char left[100], standard[HELP_DEFAULT];
            if (!help_is_of_group(i, g) || (command != COMMAND_NONE && !cli_option_is_of(i, command)))
                continue;
            left_out += hidden;
            if (hidden) continue;
            if (!shown++) fprintf(to, "\n%s (default in parentheses)\n", o->group);
            help_row(to, help_option_text(o, left), o->help, help_default(i, standard));
        }
    return left_out;
}

/* Prints the options that may stand in place of a command; arguments.c parses these. */
static void help_first(FILE *to)
{
    fputs("\nIn place of a command\n", to);
    help_row(to, "--help [all], -h", "print this overview; all: with every option of every command", "");
    help_row(to, "--version, -V", "print the version", "");
    help_row(to, "--man", "print the manual page in roff: oceanxl --man | man -l -", "");
    help_row(to, "--options-page", "print docs/OPTIONS.md", "");
}

void help_print(FILE *to, enum command command, int all)
{
    const struct cli_command *c = &CLI_COMMANDS[command];
    int left_out = 0;
    if (command == COMMAND_NONE) help_overview(to);
    else
        fprintf(to, "%s\n\n  %s\n\nUsage: oceanxl %s %s [options]\n%s\n", c->purpose, c->example, c->name,
                c->usage, c->more);
    if (command == COMMAND_NONE && all) help_first(to);
    if (command != COMMAND_NONE || all) left_out = help_options(to, command, all);
    if (left_out > 0) fprintf(to, "\nAdvanced and expert options not shown: %d (--help all)\n", left_out);
}

/* ---------------- all options and outputs, for the manual page and docs/OPTIONS.md */

/* Prints text for roff: with minus signs that can be copied, with backslashes that stay, and with no line
 * that looks like a request. */
static void manual_text(FILE *to, const char *text)
{
    for (const char *at = text; *at; at++) {
        if ((*at == '.' || *at == '\'') && (at == text || at[-1] == '\n')) fputs("\\&", to);
        if (*at == '-') fputs("\\-", to);
        else if (*at == '\\') fputs("\\e", to);
        else fputc(*at, to);
    }
}

static void manual_lines(FILE *to, const char *before, const char *text)
{
    fputs(before, to);
    manual_text(to, text);
    if (text[0] && text[strlen(text) - 1] != '\n') fputc('\n', to);
}

/* Begins a group of docs/OPTIONS.md in Markdown (page 1), or of the manual page (page 0). */
static void help_group(FILE *to, int page, const char *title)
{
    if (page) fprintf(to, "\n## %s\n\n", title);
    else manual_lines(to, ".SS ", title);
}

static void help_entry(FILE *to, int page, const char *name, const char *what)
{
    if (page) {
        fprintf(to, "- `%s`: %s\n", name, what);
        return;
    }
    manual_lines(to, ".TP\n.B ", name);
    manual_lines(to, "", what);
}

/* Prints "HELP (default; range). Advanced." */
static void help_full_option(FILE *to, int page, int index)
{
    static const char *const tiers[] = {"", " Advanced.", " Expert."};
    const oxl_option *o = cli_option_at(index);
    const int has_range =
        o->kind == OXL_OPTION_INT || o->kind == OXL_OPTION_FLOAT || o->kind == OXL_OPTION_DOUBLE;
    char name[100], standard[HELP_DEFAULT], range[40] = "", text[1000];
    help_default(index, standard);
    /* Leaves out a range that says nothing: none, a huge one, or 0 to 1. */
    if (has_range && o->high > o->low && o->high < 1e6 && !(o->low == 0 && o->high == 1))
        snprintf(range, sizeof range, "; %g to %g", o->low, o->high);
    snprintf(text, sizeof text, standard[0] ? "%s (%s%s).%s" : "%s%.0s%.0s.%s", o->help, standard, range,
             tiers[o->tier]);
    help_entry(to, page, help_option_text(o, name), text);
}

static void help_full(FILE *to, int page)
{
    for (int g = 0; g < cli_option_count(); g++) {
        if (!help_group_begins(g)) continue;
        help_group(to, page, cli_option_at(g)->group);
        for (int i = g; i < cli_option_count(); i++)
            if (help_is_of_group(i, g)) help_full_option(to, page, i);
    }
    help_group(to, page, "What train writes to OUT");
    for (size_t i = 0; i < sizeof HELP_OUTPUTS / sizeof *HELP_OUTPUTS; i++)
        help_entry(to, page, HELP_OUTPUTS[i].name, HELP_OUTPUTS[i].what);
}

/* ---------------- the manual page, in roff (man(7) macros) */

static void manual_command(FILE *to, enum command command)
{
    const struct cli_command *c = &CLI_COMMANDS[command];
    fprintf(to, ".SS oceanxl %s ", c->name);
    manual_lines(to, "", c->usage);
    manual_lines(to, "", c->purpose);
    manual_lines(to, ".PP\n.EX\n    ", c->example);
    manual_lines(to, ".EE\n.PP\n", c->more);
}

void help_manual(FILE *to)
{
    fputs(".\\\" made by: oceanxl \\-\\-man\n.TH OCEANXL 1 \"\" \"OceanXL " OXL_VERSION
          "\"\n.SH NAME\noceanxl \\- ",
          to);
    manual_text(to, HELP_PURPOSE);
    fputs(".SH SYNOPSIS\n", to);
    for (int i = 1; i < COMMANDS; i++) {
        fprintf(to, ".B oceanxl %s\n", CLI_COMMANDS[i].name);
        manual_lines(to, "", CLI_COMMANDS[i].usage);
        fputs("[options]\n.br\n", to);
    }
    manual_lines(to, ".SH COMMANDS\n", HELP_SCENE);
    for (enum command i = COMMAND_TRAIN; i < COMMANDS; i++) manual_command(to, i);
    fputs(".SH OPTIONS AND OUTPUTS\nDefaults and ranges are in parentheses.\n", to);
    help_full(to, 0);
    manual_lines(to, ".SH EXIT STATUS\n", HELP_CODES);
}

/* ---------------- docs/OPTIONS.md */

void help_page(FILE *to)
{
    fputs(
        "# Options and outputs\n\n"
        "Made by `make man` from the tables in `src/core/options.c`, `src/parts` and `cli/options.c`.\n"
        "SCENE is the folder of a survey, OUT that of a run. Defaults and ranges are in parentheses; fractions and rates go from 0 to 1. `oceanxl --help` lists the commands, `oceanxl COMMAND --help` the basic options of one, `--help all` all of them.\n"
        "A resumed run keeps the options in OUT/run.json.\n",
        to);
    help_full(to, 1);
    fprintf(to, "\nExit codes: %s", HELP_CODES);
}
