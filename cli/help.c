/* help.c - generates --help, the manual page and docs/OPTIONS.md from the tables of commands and options.
 *
 * Invariant: no option is named here: a row of a table is sufficient.
 */
#include "cli.h"

#include <string.h>

static const char HELP_PURPOSE[] = "from a COLMAP model of an underwater survey to one compact 3D Gaussian Splatting model,\n"
                                   "on a laptop without a GPU.\n";
static const char HELP_SCENE[] =
    "SCENE is a folder with images/ and sparse/0/ (or sparse/, or the files of a COLMAP model, text or binary), or with a\n"
    "transforms.json or reconstruction.json.\n";
static const char HELP_CODES[] = "0 done, 1 failed, 2 usage, 3 bad input, 4 over the memory budget, 130 interrupted.\n";

/* What train writes to OUT. */
static const struct {
    const char *name, *what;
} HELP_OUTPUTS[] = {
    {"scene.ply", "the model, for any viewer: the SH degrees in use, second lobes in an element of their own"},
    {"scene_standard.ply", "the same in the 62 columns that every 3DGS viewer reads, if scene.ply is not that already"},
    {"scene_clear.ply, imaging.txt",
     "with water: the scene without it; with exposure, lamp or water: the parameters of the image formation. eval and render use both"},
    {"metrics.json",
     "psnr, cc_psnr, ssim, ms_ssim of the held-out views, each and mean; gaussians, bytes, seconds, iterations, peak_rss_bytes"},
    {"run.json",
     "version, options (\"job\"), what rendered (\"backend\"), what was found in the survey, decisions and their evidence, log lines"},
    {"report.html", "report on one page: charts, a map, the worst views"},
    {"renders/",
     "NAME.png and NAME.image.png of each held-out view; NAME.clear.png without lamp and water, where water is fitted"},
    {"partition.txt, partition.svg", "the blocks, of a survey that was split"},
    {"blocks/KKK/",
     "of each block: model.ply, log.csv, block.json, checkpoint.oxl while it is trained; of `partition`: a COLMAP text export"},
    {"blocks/coarse/", "of a survey in several blocks: the coarse model that they begin with; blocks/whole/: the merged model"},
};

enum { HELP_DEFAULT = 160 };

/* ---------------------------------------------------------------- one option in words */

/* "8", "draft 2000, standard 7000, paper 40000", or "". */
static const char *help_default(int index, char out[HELP_DEFAULT])
{
    const oxl_option      *o        = cli_option_at(index);
    const struct arguments defaults = arguments_default();
    out[0]                          = 0;
    if (o->kind == OXL_OPTION_FLAG) return out;
    if (cli_option_of_job(index) < 0) {
        oxl_option_get(o, &defaults, out, HELP_DEFAULT);
        if (o->low > 0 && strcmp(out, "0") == 0) out[0] = 0; /* 0: not given */
    } else if (o->kind == OXL_OPTION_PRESET) snprintf(out, HELP_DEFAULT, "%s", o->preset[0]);
    else if (o->preset[0] && strcmp(o->preset[0], o->preset[1]) == 0 && strcmp(o->preset[0], o->preset[2]) == 0)
        snprintf(out, HELP_DEFAULT, "%s", o->preset[0]);
    else if (o->preset[0])
        snprintf(out, HELP_DEFAULT, "draft %s, standard %s, paper %s", o->preset[0], o->preset[1], o->preset[2]);
    return out;
}

/* "--name VALUE" */
static const char *help_option_text(const oxl_option *o, char out[100])
{
    char word[40];
    snprintf(out, 100, "%s%s%s", cli_option_word(o, word), o->value ? " " : "", o->value ? o->value : "");
    return out;
}

static int help_group_begins(int index)
{
    for (int i = 0; i < index; i++)
        if (strcmp(cli_option_at(i)->group, cli_option_at(index)->group) == 0) return 0;
    return 1;
}

/* ---------------------------------------------------------------- --help */

static void help_overview(FILE *to)
{
    fprintf(to, "OceanXL " OXL_VERSION ": %s\n", HELP_PURPOSE);
    fputs("  oceanxl train survey -o out\n\n"
          "Commands (oceanxl COMMAND --help says more, oceanxl --man is the manual page)\n",
          to);
    for (int i = 0; cli_command_at(i); i++) {
        const struct cli_command *c = cli_command_at(i);
        char                      left[64];
        snprintf(left, sizeof left, "%s %s", c->name, c->usage);
        fprintf(to, "  %-31s %s\n", left, c->purpose);
    }
    fprintf(to, "\n%sExit codes: %s", HELP_SCENE, HELP_CODES);
}

static void help_option(FILE *to, int index)
{
    const oxl_option *o = cli_option_at(index);
    char              left[100], standard[HELP_DEFAULT];
    help_default(index, standard);
    fprintf(to, "  %-31s %s%s%s%s\n", help_option_text(o, left), o->help, standard[0] ? " (" : "", standard,
            standard[0] ? ")" : "");
}

/* The options of a command, or of all commands that have any, group by group. Returns how many were left out. */
static int help_options(FILE *to, enum command command, int all)
{
    int left_out = 0;
    for (int g = 0; g < cli_option_count(); g++) {
        const char *group = cli_option_at(g)->group;
        int         shown = 0;
        for (int i = g; i < cli_option_count() && help_group_begins(g); i++) {
            const oxl_option *o = cli_option_at(i);
            if (strcmp(o->group, group) != 0 || (command != COMMAND_NONE && !cli_option_is_of(i, command))) continue;
            left_out += o->tier != OXL_TIER_BASIC && !all;
            if (o->tier != OXL_TIER_BASIC && !all) continue;
            if (!shown++) fprintf(to, "\n%s (default in parentheses)\n", group);
            help_option(to, i);
        }
    }
    return left_out;
}

void help_print(FILE *to, enum command command, int all)
{
    int left_out = 0;
    if (command == COMMAND_NONE) help_overview(to);
    for (int i = 0; cli_command_at(i); i++) {
        const struct cli_command *c = cli_command_at(i);
        if (c->command != command) continue;
        fprintf(to, "%s\n\n  %s\n\nUsage: oceanxl %s %s [options]\n%s\n", c->purpose, c->example, c->name, c->usage, c->more);
    }
    if (command != COMMAND_NONE || all) left_out = help_options(to, command, all);
    if (left_out > 0) fprintf(to, "\n%d more options, advanced and expert: --help all\n", left_out);
}

/* ---------------------------------------------------------------- the manual page: the same in roff (man(7) macros) */

/* Minus signs that can be copied, backslashes that are one, and no line that looks like a request. */
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

static void manual_command(FILE *to, const struct cli_command *c)
{
    const char *before = "Options: ";
    fprintf(to, ".SS oceanxl %s ", c->name);
    manual_lines(to, "", c->usage);
    manual_lines(to, "", c->purpose);
    manual_lines(to, ".PP\n.EX\n    ", c->example);
    manual_lines(to, ".EE\n.PP\n", c->more);
    fputs(".PP\n", to);
    for (int i = 0; i < cli_option_count(); i++) {
        char word[40];
        if (!cli_option_is_of(i, c->command)) continue;
        fputs(before, to);
        manual_text(to, cli_option_word(cli_option_at(i), word));
        before = ",\n";
    }
    fputs(".\n", to);
}

static void manual_option(FILE *to, int index)
{
    static const char *const tiers[] = {"", "Advanced.", "Expert."};
    const oxl_option        *o       = cli_option_at(index);
    char                     word[40], standard[HELP_DEFAULT];
    fputs(".TP\n\\fB", to);
    manual_text(to, cli_option_word(o, word));
    fputs("\\fR", to);
    if (o->value) {
        fputs(" \\fI", to);
        manual_text(to, o->value);
        fputs("\\fR", to);
    }
    manual_lines(to, "\n", o->help);
    if (help_default(index, standard)[0]) {
        fputs("(", to);
        manual_text(to, standard);
        fputs(").\n", to);
    }
    if (o->tier != OXL_TIER_BASIC) fprintf(to, "%s\n", tiers[o->tier]);
    if (o->alias) fprintf(to, "%s \\-\\-%s.\n", o->alias[0] == '=' ? "Also" : "Formerly", o->alias + (o->alias[0] == '='));
}

static void manual_group(FILE *to, int first)
{
    manual_lines(to, ".SS ", cli_option_at(first)->group);
    for (int i = first; i < cli_option_count(); i++)
        if (strcmp(cli_option_at(i)->group, cli_option_at(first)->group) == 0) manual_option(to, i);
}

void help_manual(FILE *to)
{
    fputs(".\\\" made by: oceanxl \\-\\-man\n.TH OCEANXL 1 \"\" \"OceanXL " OXL_VERSION "\"\n.SH NAME\noceanxl \\- ", to);
    manual_text(to, HELP_PURPOSE);
    fputs(".SH SYNOPSIS\n", to);
    for (int i = 0; cli_command_at(i); i++) {
        fprintf(to, ".B oceanxl %s\n", cli_command_at(i)->name);
        manual_lines(to, "", cli_command_at(i)->usage);
        fputs("[options]\n.br\n", to);
    }
    manual_lines(to, ".SH COMMANDS\n", HELP_SCENE);
    for (int i = 0; cli_command_at(i); i++) manual_command(to, cli_command_at(i));
    fputs(".SH OPTIONS\nDefaults are in parentheses.\n", to);
    for (int i = 0; i < cli_option_count(); i++)
        if (help_group_begins(i)) manual_group(to, i);
    fputs(".SH FILES\nWhat train writes to OUT:\n", to);
    for (size_t i = 0; i < sizeof HELP_OUTPUTS / sizeof *HELP_OUTPUTS; i++) {
        manual_lines(to, ".TP\n", HELP_OUTPUTS[i].name);
        manual_lines(to, "", HELP_OUTPUTS[i].what);
    }
    manual_lines(to, ".SH EXIT STATUS\n", HELP_CODES);
}

/* ---------------------------------------------------------------- docs/OPTIONS.md */

/* A number's range, if it is worth stating. */
static void page_range(FILE *to, const oxl_option *o)
{
    const int has = o->kind == OXL_OPTION_INT || o->kind == OXL_OPTION_FLOAT || o->kind == OXL_OPTION_DOUBLE;
    if (has && o->high > o->low && o->high < 1e6 && !(o->low == 0 && o->high == 1)) fprintf(to, "; %g to %g", o->low, o->high);
}

static void page_option(FILE *to, int index)
{
    static const char *const tiers[] = {"", " Advanced.", " Expert."};
    const oxl_option        *o       = cli_option_at(index);
    char                     left[100], standard[HELP_DEFAULT];
    fprintf(to, "- `%s`: %s", help_option_text(o, left), o->help);
    help_default(index, standard);
    if (standard[0]) {
        fprintf(to, " (%s", standard);
        page_range(to, o);
        fputs(")", to);
    }
    fprintf(to, ".%s", tiers[o->tier]);
    if (o->alias) fprintf(to, " %s `--%s`.", o->alias[0] == '=' ? "Also" : "Formerly", o->alias + (o->alias[0] == '='));
    fputs("\n", to);
}

void help_page(FILE *to)
{
    fputs(
        "# Options and outputs\n\n"
        "Made by `make man` from the tables in `src/core/options.c` (the training job) and `cli/options.c` (the program): change it "
        "there.\n"
        "Defaults and ranges are in parentheses; shares and rates go from 0 to 1. `oceanxl COMMAND --help` shows the basic options of a command, `--help all` every one.\n"
        "A resumed run keeps the options in OUT/run.json.\n",
        to);
    for (int g = 0; g < cli_option_count(); g++) {
        if (!help_group_begins(g)) continue;
        fprintf(to, "\n## %s\n\n", cli_option_at(g)->group);
        for (int i = g; i < cli_option_count(); i++)
            if (strcmp(cli_option_at(i)->group, cli_option_at(g)->group) == 0) page_option(to, i);
    }
    fputs("\n## What train writes to OUT\n\n", to);
    for (size_t i = 0; i < sizeof HELP_OUTPUTS / sizeof *HELP_OUTPUTS; i++)
        fprintf(to, "- `%s`: %s.\n", HELP_OUTPUTS[i].name, HELP_OUTPUTS[i].what);
    fprintf(to, "\nExit codes: %s", HELP_CODES);
}
