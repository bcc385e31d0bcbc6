/* arguments.c - the command line's words: one table of commands, one of options; both parse, and make the help and the manual page.
 *
 * Invariant: an option that is not in the table is an error. Nothing is accepted in silence.
 */
#include "cli.h"

#include <ctype.h>
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#define COUNT(array) (sizeof(array) / sizeof *(array))
#define FIELD(name)  offsetof(struct arguments, name)
#define IN(command)  (1u << COMMAND_##command)
#define TRAINS       (IN(TRAIN) | IN(CHECK) | IN(PARTITION))
#define STUDIES      (IN(ABLATE) | IN(TRADEOFF))
#define RUNS         (TRAINS | STUDIES)
#define SCENES       (RUNS | IN(RENDER) | IN(EVAL) | IN(MEASURE))
#define DRAWS        (IN(TRAIN) | IN(CHECK) | IN(MERGE) | IN(RENDER) | IN(EVAL) | STUDIES)
#define EVERYWHERE   (~0u)

static const struct {
    const char  *name;
    enum command command;
    int          paths;
    const char  *usage, *purpose, *example, *more;
} commands[] = {
    {"train", COMMAND_TRAIN, 1, "SCENE -o OUT", "Trains a survey: photographs and a COLMAP text export in, one splat model out.",
     "oceanxl train survey -o out",
     "OUT gets scene.ply (scene_standard.ply too, if other viewers need it), report.html to look at, metrics.json, run.json, renders/ of the held-out views, and blocks/KKK/.\n"
     "Ctrl-C stops in good order and saves the state, a crash loses a minute: run the same command again, and it goes on."},
    {"merge", COMMAND_MERGE, 1, "OUT", "Joins the blocks that train --block K made, refines them together, judges the whole.",
     "oceanxl merge out", "OUT gets what train would have left there, to the byte."},
    {"check", COMMAND_CHECK, 1, "SCENE", "Lints a survey: says what train would find, and what it would take.",
     "oceanxl check survey", "Exit code 3: it cannot be trained, and the message says why."},
    {"partition", COMMAND_PARTITION, 1, "SCENE -o OUT",
     "Cuts a survey into blocks of equal work, each a COLMAP text export of its own.", "oceanxl partition survey -o out",
     "OUT gets blocks/000/ and so on, which COLMAP and other trainers open, partition.txt, and partition.svg to look at."},
    {"render", COMMAND_RENDER, 2, "MODEL SCENE -o DIR",
     "Draws a model from the cameras of a survey, or from above, or along a path.",
     "oceanxl render out/scene.ply survey -o pictures",
     "One PNG a view, named as its photograph; --ortho and --path draw others instead."},
    {"measure", COMMAND_MEASURE, 1, "SCENE --scale-bar ENDS",
     "Measures in a survey: a scale bar's length, and so how many metres a unit has.",
     "oceanxl measure survey --scale-bar a.jpg,410,300,b.jpg,95,310:a.jpg,700,320,b.jpg,390,333 --length 0.5",
     "Pixels are those of the photographs as they are, their top-left pixel's centre is 0.5,0.5. The scale goes to render and convert."},
    {"eval", COMMAND_EVAL, 2, "MODEL SCENE",
     "Compares a model with photographs: PSNR, cc-PSNR (without exposure), SSIM and MS-SSIM, for each view and in the mean.",
     "oceanxl eval out/scene.ply survey",
     "The photographs compared with are those that train held out, unless --split says otherwise. LPIPS needs a trained network and is\n"
     "not available: compare OUT/renders/NAME.png with NAME.photo.png by a program that has one."},
    {"info", COMMAND_INFO, 1, "FILE", "Says what a model file holds.", "oceanxl info out/scene.ply", "Reads .ply and .splat."},
    {"convert", COMMAND_CONVERT, 2, "IN OUT", "Converts between .ply and .splat, by the files' extensions.",
     "oceanxl convert out/scene.ply scene.splat", ".splat holds 32 bytes a Gaussian and no colour that depends on the view."},
    {"report", COMMAND_REPORT, 1, "OUT", "Writes what a run found, decided and reached as one page.", "oceanxl report out",
     "OUT gets report.html: one file, for a screen, a phone or paper, that needs no network. train and merge write it too, at their end."},
    {"synth", COMMAND_SYNTH, 0, "-o DIR", "Makes a synthetic underwater survey with known truth, as a COLMAP text export.",
     "oceanxl synth -o survey",
     "DIR gets images/, sparse/0/ and truth/: pictures without water, depth maps, the water's parameters."},
    {"ablate", COMMAND_ABLATE, 1, "SCENE -o OUT", "Trains the paper's variants side by side: what each part brings, and costs.",
     "oceanxl ablate survey -o ablation --preset standard --seeds 3",
     "OUT gets ablation.csv, ablation.svg, and a run as train leaves it for each row and seed, in NAME-seedS/. A stopped one goes on when it\n"
     "is run again. All rows share the options below. Rows: 3dgs (midpoint cuts), v1 (+BSP), v2 (+UCD), v3 (+WAP), v4 (+DoG on all),\n"
     "oceanxl (DoG selective); and, when named, v3-315 (keeps 0.315, as the paper's sizes say), auto (oceanxl with --ucd auto)."},
    {"tradeoff", COMMAND_TRADEOFF, 1, "SCENE -o OUT",
     "Measures what speed costs in accuracy on a survey: options one at a time, and the presets.",
     "oceanxl tradeoff survey -o tradeoff --budget 20m",
     "OUT gets tradeoff.md (a page with tables and words), tradeoff.svg, tradeoff.csv, and a run for each row and seed, in NAME-seedS/. Rows that\n"
     "do not fit the budget are named; the same command with a larger one goes on. Without --max-side photographs are reduced to fit it."},
};

enum kind {
    FLAG,
    COUNTING,
    LARGE,
    REAL,
    DEGREE,
    SIZE,
    DURATION,
    PIXELS,
    PLACE,
    TEXT,
    PRESET,
    SPLIT,
    AXES,
    CUT,
    DOG,
    SWITCH,
    BACKEND,
    LIMIT,
    SHARE
};

static const struct option {
    const char *group, *name, *value;
    enum kind   kind;
    size_t      field;
    unsigned    commands;
    const char *help;
} options[] = {
    {"What is compared", "--rows", "NAME,NAME...", TEXT, FIELD(rows), IN(ABLATE),
     "variants, the first is what the others are compared with (3dgs,v1,v2,v3,v4,oceanxl)"},
    {"What is compared", "--rows", "NAME,NAME...", TEXT, FIELD(rows), IN(TRADEOFF),
     "beside the base: iterations-half, coarse-0.25, ssim-every-2, draft, standard and so on (all)"},
    {"What is compared", "--seeds", "N", COUNTING, FIELD(seeds), STUDIES, "each row is trained with seeds 1 to N (1)"},
    {"What is compared", "--budget", "TIME", DURATION, FIELD(budget), IN(TRADEOFF), "for all of it, as 90s, 20m or 8h (20m)"},
    {"What is read", "--images", "FOLDER", TEXT, FIELD(images), SCENES, "photographs (SCENE/images)"},
    {"What is read", "--sparse", "FOLDER", TEXT, FIELD(sparse), SCENES,
     "cameras.txt, images.txt, points3D.txt (SCENE/sparse/0, SCENE/sparse or SCENE)"},
    {"What is read", "--masks", "FOLDER", TEXT, FIELD(masks), SCENES, "masks, black is ignored (SCENE/masks, when it is there)"},
    {"What is read", "--max-side", "PX", COUNTING, FIELD(max_side), SCENES,
     "reduce photographs until the longer side is at most this (1600)"},
    {"What is read", "--test-every", "N", COUNTING, FIELD(test_every), SCENES,
     "hold out every N-th photograph by name; 0: none (8)"},
    {"What is read", "--image-cache", "SIZE", SIZE, FIELD(image_cache), SCENES,
     "decoded photographs kept in memory, as 512M or 4G (1G)"},
    {"What is made", "--views", "N", COUNTING, FIELD(synth.views), IN(SYNTH), "photographs (40)"},
    {"What is made", "--size", "WxH", PIXELS, FIELD(synth.width), IN(SYNTH), "of a photograph, px (400x260)"},
    {"What is made", "--path", "lawnmower|orbit|forward", TEXT, FIELD(synth.path), IN(SYNTH), "how the camera flies (lawnmower)"},
    {"What is made", "--extent", "METRES", REAL, FIELD(synth.extent), IN(SYNTH),
     "side of the area flown over, or diameter of the orbit; 0: as the overlap wants (0)"},
    {"What is made", "--water", "TYPE", TEXT, FIELD(synth.water), IN(SYNTH),
     "none, or Jerlov's type: I IA IB II III 1C 3C 5C 7C 9C (1C)"},
    {"What is made", "--noise", "SIGMA", REAL, FIELD(synth.noise), IN(SYNTH), "of the sensor, in 8-bit levels (1.5)"},
    {"What is made", "--fish", "N", COUNTING, FIELD(synth.fish), IN(SYNTH),
     "that swim into each photograph, and out of it; truth/still/ and truth/masks/ are without them (0)"},
    {"What is made", "--exposure-jitter", "STOPS", REAL, FIELD(synth.exposure_jitter), IN(SYNTH),
     "by which photographs get brighter and darker along the path, at most (0)"},
    {"What is made", "--lamp", "POWER", REAL, FIELD(synth.lamp), IN(SYNTH),
     "a lamp that moves with the camera; its light falls off with this power of the range, 0 to 2 (none)"},
    {"What is made", "--points", "N", LARGE, FIELD(synth.points), IN(SYNTH), "sparse points; 0: 400 a view (0)"},
    {"What is made", "--origin", "X,Y,Z", PLACE, FIELD(synth.origin), IN(SYNTH),
     "where the middle lies in the export's world, metres (0,0,0)"},
    {"What is made", "--no-images", NULL, FLAG, FIELD(no_images), IN(SYNTH), "the three text files alone, for load tests"},
    {"What is written", "-o", "FOLDER", TEXT, FIELD(out), IN(TRAIN) | IN(RENDER) | IN(SYNTH) | IN(PARTITION) | STUDIES,
     "where to; made when it is not there"},
    {"What is written", "--split", "test|train|all", SPLIT, FIELD(split), IN(RENDER) | IN(EVAL), "which views (test)"},
    {"What is written", "--depth", NULL, FLAG, FIELD(depth), IN(RENDER),
     "depth too: NAME.depth.png to look at; NAME.depth.pfm to measure, in the survey's unit; NAME.depth16.png in thousandths of it"},
    {"What is written", "--clear", NULL, FLAG, FIELD(clear), IN(RENDER),
     "the scene at mean exposure, where the model has an imaging.txt beside it"},
    {"What is written", "--ortho", NULL, FLAG, FIELD(ortho), IN(RENDER),
     "an orthomosaic instead: ortho.png with its world file ortho.pgw; with --depth the heights, ortho.height.pfm"},
    {"What is written", "--pixel", "SIZE", REAL, FIELD(pixel), IN(RENDER),
     "of the orthomosaic, in units, or in metres with --scale; 0: 2048 px on the longer side (0)"},
    {"What is written", "--path", "orbit|survey", TEXT, FIELD(flight), IN(RENDER),
     "frames of a flight instead, around the middle or along the cameras: frame_00000.png and on"},
    {"What is written", "--frames", "N", COUNTING, FIELD(frames), IN(RENDER), "of the flight (120)"},
    {"What is written", "--scale", "METRES", REAL, FIELD(scale), IN(RENDER) | IN(CONVERT),
     "that a unit of the survey has, as measure tells: depths, heights and places in metres, models scaled (1)"},
    {"What is measured", "--scale-bar", "ENDS", TEXT, FIELD(bar), IN(MEASURE),
     "IMG1,X,Y,IMG2,X,Y:IMG1,X,Y,IMG2,X,Y, both ends in two photographs or more; or X,Y,Z:X,Y,Z in the survey's units"},
    {"What is measured", "--length", "METRES", REAL, FIELD(length), IN(MEASURE), "of the bar (not known)"},
    {"What is written", "--json", NULL, FLAG, FIELD(json), TRAINS | IN(EVAL) | IN(INFO), "results on standard output as JSON"},
    {"How it is cut into blocks", "--block-points", "N", COUNTING, FIELD(block_points), RUNS,
     "a block of more points than this is cut (40000)"},
    {"How it is cut into blocks", "--partition", "auto|2d|3d|none", AXES, FIELD(axes), RUNS,
     "2d: never across the third principal axis; auto: 2d when the survey is flat; none: one block (auto)"},
    {"How it is cut into blocks", "--split", "balanced|midpoint", CUT, FIELD(cut), TRAINS,
     "balanced: both sides hold equal numbers of points; midpoint: the baseline (balanced)"},
    {"How it is cut into blocks", "--refine", "SHARE", REAL, FIELD(refine), RUNS | IN(MERGE),
     "of the blocks' steps, that all get together on all photographs after they are merged; 0: none (0.1)"},
    {"How it is trained", "--preset", "draft|standard|paper", PRESET, FIELD(preset), RUNS, "how long and how carefully (draft)"},
    {"How it is trained", "--iterations", "N", COUNTING, FIELD(iterations), RUNS, "steps, of one photograph each (the preset's)"},
    {"How it is trained", "--max-time", "TIME", DURATION, FIELD(max_time), TRAINS,
     "stop in good order after 90s, 20m or 8h (no limit)"},
    {"How it is trained", "--max-gaussians", "N", COUNTING, FIELD(max_gaussians), RUNS,
     "never more than this many, shared by the blocks (one for every 60 training pixels)"},
    {"How it is trained", "--sh-degree", "auto|0..3", DEGREE, FIELD(sh_degree), RUNS,
     "colour that changes with the view: bands of spherical harmonics; auto: those that pay on views held out (auto, paper: 3)"},
    {"How it is trained", "--block", "K", COUNTING, FIELD(block), IN(TRAIN), "this block alone, from 0; merge joins them (all)"},
    {"How it is trained", "--restart", NULL, FLAG, FIELD(restart), IN(TRAIN) | STUDIES,
     "give up the unfinished work of other options in OUT"},
    {"How it is trained", "--ram", "SIZE", SIZE, FIELD(ram), RUNS,
     "memory that may be taken at the peak: blocks, photographs' cache and Gaussians follow (no limit)"},
    {"Speed for accuracy", "--ssim-every", "N", COUNTING, FIELD(ssim_every), RUNS,
     "SSIM in every N-th step, L1 alone in the others (1: in all)"},
    {"Speed for accuracy", "--exp", "3|5", COUNTING, FIELD(exp_degree), RUNS,
     "degree of the polynomial that the CPU takes for 2^x in training: 5, exact to a float; 3 is quicker, 0.0075 % off (3, paper: 5)"},
    {"Speed for accuracy", "--alpha-min", "ALPHA", REAL, FIELD(alpha_min), RUNS,
     "the CPU leaves out what splats fainter than this add to a pixel, in the first 0.8 of the run, as 0.03 (1/255)"},
    {"Speed for accuracy", "--tile-share", "SHARE", REAL, FIELD(tile_share), RUNS,
     "of each photograph's tiles, by chance, whose gradient the CPU takes in a step, as 0.5 (1)"},
    {"Speed for accuracy", "--coarse", "auto|SHARE", SHARE, FIELD(coarse), RUNS,
     "of the run, its first, at half the photographs' sides, as 0.25; auto: 0.25 of 640 px and more (0, draft: auto)"},
    {"Speed for accuracy", "--stop-early", NULL, FLAG, FIELD(stop_early), RUNS,
     "an eighth of the training views, 8 at most, stand aside for the whole run; it ends, in its second half, when they have not gained for 3/20 of it"},
    {"Speed for accuracy", "--sh-every", "SHARE", REAL, FIELD(bands_every), RUNS,
     "of the run, after which there is one more band of spherical harmonics, as 0.2 (0.0333)"},
    {"Speed for accuracy", "--haste", "POWER", REAL, FIELD(haste), RUNS,
     "shorter runs take steps of geometry (30000 / iterations)^POWER times the usual ones, start sharper, keep less momentum (0.35, paper: 0)"},
    {"Speed for accuracy", "--settle", "SHARE", REAL, FIELD(settle), RUNS,
     "of the run, its last, over which all steps shrink to a tenth; 0: none (0.2)"},
    {"What the scene requires", "--ucd", "on|off|auto|MID,FAR", TEXT, FIELD(ucd), TRAINS,
     "densify more readily what is far away in water: weights of two depth bands, learned; MID,FAR: from there (auto)"},
    {"What the scene requires", "--keep", "FRACTION|COUNT|SIZE|auto|all", TEXT, FIELD(keep), TRAINS,
     "Gaussians left after pruning, of all blocks together, as 0.5, 400000 or 80MB (all)"},
    {"What the scene requires", "--robust", NULL, FLAG, FIELD(robust), TRAINS,
     "do not learn what one photograph has and the others of the place have not: fish, divers, drifting things"},
    {"What the scene requires", "--exposure", "off|on|auto", SWITCH, FIELD(exposure), TRAINS,
     "brightness and white balance that differ from photograph to photograph; auto: if that pays on views held out (off)"},
    {"What the scene requires", "--medium", NULL, FLAG, FIELD(medium), TRAINS,
     "model the water's attenuation and backscatter by nine parameters (CPU)"},
    {"What the scene requires", "--dog", "off|selective|all|auto", DOG, FIELD(dog), TRAINS,
     "difference-of-Gaussians lobes; auto: selective, if they pay on views held out (off)"},
    {"What the scene requires", "--dog-threshold", "T|SHARE%", LIMIT, FIELD(dog_threshold), TRAINS | IN(ABLATE),
     "selective: of the mean gradient, in half images; or the share that stays without, as 90% (0.0002)"},
    {"The program", "--seed", "S", COUNTING, FIELD(seed), TRAINS | IN(SYNTH),
     "of every random choice; the same seed gives the same bytes (1)"},
    {"The program", "--backend", "cpu|vulkan|auto", BACKEND, FIELD(backend), DRAWS,
     "what draws and trains; vulkan: in builds with make VULKAN=1; auto: a GPU if there is one (cpu)"},
    {"The program", "--device", "N", COUNTING, FIELD(device), DRAWS, "of the list of info --devices, from 0 (the best of them)"},
    {"The program", "--devices", NULL, FLAG, FIELD(devices), IN(INFO), "the Vulkan devices here instead, no FILE is wanted"},
    {"The program", "--threads", "T", COUNTING, FIELD(threads), EVERYWHERE, "threads; the result does not depend on them (all)"},
    {"The program", "--quiet", NULL, FLAG, FIELD(quiet), EVERYWHERE, "only warnings and errors on standard error"},
    {"The program", "--help", NULL, FLAG, FIELD(help), EVERYWHERE, "this text"},
};

/* ---------------------------------------------------------------- help */

static void help_option(FILE *to, const struct option *o)
{
    char left[64];
    snprintf(left, sizeof left, "%s%s%s", o->name, o->value ? " " : "", o->value ? o->value : "");
    fprintf(to, "  %-31s %s\n", left, o->help);
}

static const char help_purpose[] =
    "from a COLMAP text export of an underwater survey to one compact 3D Gaussian Splatting model,\n"
    "on a laptop without a GPU.\n",
                  help_scene[] =
                      "SCENE is a folder with images/ and sparse/0/ (or sparse/, or the three text files themselves).\n",
                  help_codes[] = "0 done, 1 failed, 2 usage, 3 bad input, 4 over the memory budget, 130 interrupted.\n";

static void help_overview(FILE *to)
{
    fprintf(to, "OceanXL " OXL_VERSION ": %s\n", help_purpose);
    fputs("  oceanxl train survey -o out\n\n"
          "Commands (oceanxl COMMAND --help says more, oceanxl --man is the manual page)\n",
          to);
    for (size_t i = 0; i < COUNT(commands); i++) {
        char left[64];
        snprintf(left, sizeof left, "%s %s", commands[i].name, commands[i].usage);
        fprintf(to, "  %-31s %s\n", left, commands[i].purpose);
    }
    fprintf(to, "\n%sExit codes: %s", help_scene, help_codes);
}

void arguments_help(FILE *to, enum command command)
{
    const char *group = "";
    if (command == COMMAND_NONE) {
        help_overview(to);
        return;
    }
    for (size_t i = 0; i < COUNT(commands); i++)
        if (commands[i].command == command)
            fprintf(to, "%s\n\n  %s\n\nUsage: oceanxl %s %s [options]\n%s\n", commands[i].purpose, commands[i].example,
                    commands[i].name, commands[i].usage, commands[i].more);
    for (size_t i = 0; i < COUNT(options); i++) {
        if (!(options[i].commands & 1u << command)) continue;
        if (strcmp(group, options[i].group) != 0) fprintf(to, "\n%s (default in parentheses)\n", options[i].group);
        group = options[i].group;
        help_option(to, &options[i]);
    }
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

static void manual_command(FILE *to, size_t command)
{
    const char *before = "Options: ";
    fprintf(to, ".SS oceanxl %s ", commands[command].name);
    manual_lines(to, "", commands[command].usage);
    manual_lines(to, "", commands[command].purpose);
    manual_lines(to, ".PP\n.EX\n    ", commands[command].example);
    manual_lines(to, ".EE\n.PP\n", commands[command].more);
    fputs(".PP\n", to);
    for (size_t i = 0; i < COUNT(options); i++) {
        if (!(options[i].commands & 1u << commands[command].command)) continue;
        fputs(before, to);
        manual_text(to, options[i].name);
        before = ",\n";
    }
    fputs(".\n", to);
}

/* The commands that have it; nothing when all do. */
static void manual_of(FILE *to, const struct option *o)
{
    const char *between = "Of ";
    if (o->commands == EVERYWHERE) return;
    for (size_t i = 0; i < COUNT(commands); i++) {
        if (!(o->commands & 1u << commands[i].command)) continue;
        fprintf(to, "%s%s", between, commands[i].name);
        between = ", ";
    }
    fputs(".\n", to);
}

static void manual_group(FILE *to, const char *group)
{
    manual_lines(to, ".SS ", group);
    for (size_t i = 0; i < COUNT(options); i++) {
        if (strcmp(options[i].group, group) != 0) continue;
        fputs(".TP\n\\fB", to);
        manual_text(to, options[i].name);
        fputs("\\fR", to);
        if (options[i].value) {
            fputs(" \\fI", to);
            manual_text(to, options[i].value);
            fputs("\\fR", to);
        }
        manual_lines(to, "\n", options[i].help);
        fputs(".br\n", to);
        manual_of(to, &options[i]);
    }
}

static int manual_is_first(size_t option)
{
    for (size_t i = 0; i < option; i++)
        if (strcmp(options[i].group, options[option].group) == 0) return 0;
    return 1;
}

void arguments_manual(FILE *to)
{
    fputs(".\\\" made by: oceanxl \\-\\-man\n.TH OCEANXL 1 \"\" \"OceanXL " OXL_VERSION "\"\n.SH NAME\noceanxl \\- ", to);
    manual_text(to, help_purpose);
    fputs(".SH SYNOPSIS\n", to);
    for (size_t i = 0; i < COUNT(commands); i++) {
        fprintf(to, ".B oceanxl %s\n", commands[i].name);
        manual_lines(to, "", commands[i].usage);
        fputs("[options]\n.br\n", to);
    }
    manual_lines(to, ".SH COMMANDS\n", help_scene);
    for (size_t i = 0; i < COUNT(commands); i++) manual_command(to, i);
    fputs(".SH OPTIONS\nDefaults are in parentheses.\n", to);
    for (size_t i = 0; i < COUNT(options); i++)
        if (manual_is_first(i)) manual_group(to, options[i].group);
    manual_lines(to, ".SH EXIT STATUS\n", help_codes);
}

/* ---------------------------------------------------------------- values */

#define PARSE_MOST  1e15 /* bytes, seconds, metres: what is beyond was not meant */
#define PARSE_LEAST 1e-9 /* of what is not 0 */

/* A plain number and its unit: 1 when there is a number and nothing but a unit of the list follows. */
static int parse_number(const char *text, const char *units, const double *factors, double *out)
{
    char       *end;
    const char *unit;
    if (!isdigit((unsigned char)text[0]) && text[0] != '.') return 0;
    *out = strtod(text, &end);
    if (*end == 0) return *out <= PARSE_MOST;
    unit = strchr(units, tolower((unsigned char)*end));
    if (!unit || end[1] != 0) return 0;
    *out *= factors[unit - units];
    return *out <= PARSE_MOST;
}

static int parse_word(const char *text, const char *const *words, int count, int *out)
{
    for (int i = 0; i < count; i++)
        if (strcmp(text, words[i]) == 0) {
            *out = i;
            return 1;
        }
    return 0;
}

static int parse_count(const char *text, double most, double *out)
{
    const size_t digits = strspn(text, "0123456789");
    *out                = strtod(text, NULL);
    return digits > 0 && text[digits] == 0 && *out <= most;
}

/* "400x260" into out[0], out[1]. */
static int parse_pixels(const char *text, int *out)
{
    double      width, height;
    const char *x = strchr(text, 'x');
    char        left[12];
    if (!x || (size_t)(x - text) >= sizeof left) return 0;
    memcpy(left, text, (size_t)(x - text));
    left[x - text] = 0;
    if (!parse_count(left, 65535, &width) || !parse_count(x + 1, 65535, &height)) return 0;
    out[0] = (int)width, out[1] = (int)height;
    return width > 0 && height > 0;
}

/* "X,Y,Z" into out[0..2]. */
static int parse_place(const char *text, double *out)
{
    for (int k = 0; k < 3; k++) {
        char *end;
        out[k] = strtod(text, &end);
        if (end == text || *end != (k < 2 ? ',' : 0) || !(fabs(out[k]) <= PARSE_MOST)) return 0;
        text = end + 1;
    }
    return 1;
}

/* 0.0002, or 90%: stored as -0.9. */
static int parse_limit(const char *text, double *out)
{
    char *end;
    if (!isdigit((unsigned char)text[0]) && text[0] != '.') return 0;
    *out = strtod(text, &end);
    if (end == text || *out > PARSE_MOST) return 0;
    if (*end == '%' && end[1] == 0 && *out <= 100) {
        *out = -*out / 100;
        return 1;
    }
    return *end == 0 && *out >= PARSE_LEAST;
}

static int parse_value(const struct option *o, const char *text, struct arguments *a)
{
    static const char *const presets[] = {"draft", "standard", "paper"}, *const splits[] = {"test", "train", "all"};
    static const char *const switches[] = {"off", "on", "auto"};
    static const char *const axes[] = {"auto", "2d", "3d", "none"}, *const cuts[] = {"balanced", "midpoint"};
    static const char *const dogs[] = {"off", "selective", "all", "auto"}, *const backends[] = {"cpu", "auto", "vulkan"};
    static const double bytes[] = {1024., 1048576., 1073741824., 1099511627776.}, seconds[] = {1, 60, 3600, 86400};
    void *const         field = (char *)a + o->field;
    double              number;
    switch (o->kind) {
    case FLAG: *(int *)field = 1; return 1;
    case TEXT: *(const char **)field = text; return text[0] != 0;
    case PRESET: return parse_word(text, presets, 3, field);
    case SPLIT: return parse_word(text, splits, 3, field);
    case AXES: return parse_word(text, axes, 4, field);
    case CUT: return parse_word(text, cuts, 2, field);
    case SIZE: return parse_number(text, "kmgt", bytes, field);
    case DURATION: return parse_number(text, "smhd", seconds, field) && *(double *)field > 0;
    case DEGREE:
        if (strcmp(text, "auto") == 0) return *(int *)field = -1, 1;
        if (!parse_count(text, 3, &number)) return 0;
        *(int *)field = (int)number;
        return 1;
    case DOG: return parse_word(text, dogs, 4, field);
    case SWITCH: return parse_word(text, switches, 3, field);
    case BACKEND: return parse_word(text, backends, 3, field);
    case LIMIT: return parse_limit(text, field);
    case SHARE:
        if (strcmp(text, "auto") == 0) return *(double *)field = -1, 1;
        return parse_number(text, "", NULL, field) && *(double *)field <= 1;
    case PIXELS: return parse_pixels(text, field);
    case PLACE: return parse_place(text, field);
    case REAL:
        return parse_number(text, "", NULL, &number) && (number == 0 || number >= PARSE_LEAST) && (*(double *)field = number, 1);
    case LARGE:
        if (!parse_count(text, 2147483647, &number)) return 0;
        *(long *)field = (long)number;
        return 1;
    case COUNTING:
        if (o->field == FIELD(seed)) return parse_count(text, 9007199254740992., field);
        if (!parse_count(text, 2147483647, &number)) return 0;
        *(int *)field = (int)number;
        return 1;
    }
    return 0;
}

/* ---------------------------------------------------------------- names */

/* Edits between two words (Levenshtein), enough for names of up to 31 letters. */
static int distance(const char *a, const char *b)
{
    int row[32];
    int nb = (int)strlen(b);
    if (nb > 31) return 99;
    for (int j = 0; j <= nb; j++) row[j] = j;
    for (int i = 0; a[i]; i++) {
        int diagonal = row[0];
        row[0]       = i + 1;
        for (int j = 1; j <= nb; j++) {
            int best = diagonal + (a[i] != b[j - 1]);
            diagonal = row[j];
            if (row[j] + 1 < best) best = row[j] + 1;
            if (row[j - 1] + 1 < best) best = row[j - 1] + 1;
            row[j] = best;
        }
    }
    return row[nb];
}

static void offer(const char *word, const char *name, const char **best, int *least)
{
    const int d = distance(word, name);
    if (d < *least) *least = d, *best = name;
}

static int unknown(const char *what, const char *word, const char *best, const char *command, char *error, size_t size)
{
    snprintf(error, size, "%s '%s' is not known%s%s%s\nfix: oceanxl %s%s--help lists them", what, word,
             best ? "; did you mean " : "", best ? best : "", best ? "?" : "", command, command[0] ? " " : "");
    return 1;
}

static const char *command_name(enum command command)
{
    for (size_t i = 0; i < COUNT(commands); i++)
        if (commands[i].command == command) return commands[i].name;
    return "";
}

/* What the rows of an ablation differ by. */
static int is_set_by_rows(const char *word)
{
    static const char *const names[] = {"--ucd", "--keep", "--dog", "--split"};
    for (size_t i = 0; i < COUNT(names); i++)
        if (strncmp(word, names[i], strlen(names[i])) == 0 && strchr("=", word[strlen(names[i])])) return 1;
    return 0;
}

static int unknown_option(const char *word, const struct arguments *a, char *error, size_t size)
{
    const char *best  = NULL;
    int         least = 4; /* further away it would be a guess */
    if (a->command == COMMAND_ABLATE && is_set_by_rows(word)) {
        snprintf(error, size, "option '%s': each row of ablate sets it itself\nfix: choose the rows, as --rows 3dgs,v2,oceanxl",
                 word);
        return 1;
    }
    for (size_t i = 0; i < COUNT(options); i++)
        if (options[i].commands & 1u << a->command) offer(word, options[i].name, &best, &least);
    return unknown("option", word, best, command_name(a->command), error, size);
}

static int find_command(const char *word, struct arguments *a, char *error, size_t size)
{
    const char *best  = NULL;
    int         least = 4;
    for (size_t i = 0; i < COUNT(commands); i++) {
        if (strcmp(word, commands[i].name) == 0) {
            a->command = commands[i].command;
            return 0;
        }
        offer(word, commands[i].name, &best, &least);
    }
    return unknown("command", word, best, "", error, size);
}

/* ---------------------------------------------------------------- parsing */

static int is_named(const struct option *o, const char *word, unsigned command)
{
    return (o->commands & 1u << command) && strncmp(word, o->name, strlen(o->name)) == 0 &&
           (word[strlen(o->name)] == 0 || word[strlen(o->name)] == '=');
}

/* One option at argv[*at], as "--name value" or "--name=value". */
static int parse_option(int argc, char **argv, int *at, struct arguments *a, char *error, size_t size)
{
    const char          *word = argv[*at], *value = strchr(word, '=');
    const struct option *o = NULL;
    for (size_t i = 0; i < COUNT(options); i++)
        if (is_named(&options[i], word, a->command)) o = &options[i];
    if (!o) return unknown_option(word, a, error, size);
    if (value) value++;
    else if (o->kind != FLAG && *at + 1 < argc) value = argv[++*at];
    if (o->kind == FLAG ? value != NULL : value == NULL) {
        snprintf(error, size, "option %s takes %s%s", o->name, o->value ? "a value: " : "no value", o->value ? o->value : "");
        return 1;
    }
    if (parse_value(o, value, a)) return 0;
    snprintf(error, size, "option %s: '%s' seen, %s wanted: %s", o->name, value, o->value, o->help);
    return 1;
}

static int check_complete(const struct arguments *a, char *error, size_t size)
{
    if (a->ortho && a->flight) {
        snprintf(error, size, "--ortho draws one picture, --path many\nfix: leave one of the two out");
        return 1;
    }
    for (size_t i = 0; i < COUNT(commands); i++) {
        if (commands[i].command != a->command || a->devices) continue;
        if (a->path_count != commands[i].paths || (strstr(commands[i].usage, "-o ") && !a->out)) {
            snprintf(error, size, "oceanxl %s wants %s\nfix: for example: %s", commands[i].name, commands[i].usage,
                     commands[i].example);
            return 1;
        }
    }
    return 0;
}

int arguments_parse(int argc, char **argv, struct arguments *a, char *error, size_t size)
{
    *a = (struct arguments){.preset        = -1,
                            .split         = -1,
                            .axes          = -1,
                            .cut           = -1,
                            .block_points  = -1,
                            .refine        = -1,
                            .iterations    = -1,
                            .max_gaussians = -1,
                            .sh_degree     = -2,
                            .max_side      = -1,
                            .test_every    = -1,
                            .threads       = -1,
                            .device        = -1,
                            .block         = -1,
                            .ram           = -1,
                            .seeds         = 1,
                            .frames        = 120,
                            .budget        = 1200,
                            .dog           = -1,
                            .exposure      = -1,
                            .dog_threshold = -2,
                            .ssim_every    = -1,
                            .exp_degree    = -1,
                            .alpha_min     = -1,
                            .tile_share    = -1,
                            .coarse        = -2,
                            .bands_every   = -1,
                            .haste         = -1,
                            .settle        = -1,
                            .max_time      = -1,
                            .image_cache   = -1,
                            .seed          = -1,
                            .synth         = synth_options_default()};
    if (argc > 1 && (strcmp(argv[1], "--version") == 0 || strcmp(argv[1], "-V") == 0)) a->version = 1;
    else if (argc > 1 && (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0 || strcmp(argv[1], "help") == 0))
        a->help = 1;
    else if (argc > 1 && strcmp(argv[1], "--man") == 0) a->manual = 1;
    if (a->version || a->help || a->manual) return 0;
    if (argc < 2) {
        snprintf(
            error, size,
            "a command is wanted: train, check, partition, render, eval, measure, info, convert, report, synth, ablate, tradeoff\nfix: oceanxl --help");
        return 1;
    }
    if (find_command(argv[1], a, error, size)) return 1;
    for (int i = 2; i < argc; i++) {
        if (strcmp(argv[i], "-h") == 0) a->help = 1;
        else if (argv[i][0] == '-' && argv[i][1]) {
            if (parse_option(argc, argv, &i, a, error, size)) return 1;
        } else if (a->path_count < 2) a->path[a->path_count++] = argv[i];
        else {
            snprintf(error, size, "'%s' is one word too many", argv[i]);
            return 1;
        }
    }
    return a->help ? 0 : check_complete(a, error, size);
}
