/* options.c - the options of a training job: one table with a row per option, and its parser, printer and
 * range checks. It lies in the lowest layer because the functions of all layers take their defaults from it.
 *
 * Made from the table: defaults of each preset, parsing and range checks, the line "job" of run.json and its
 * reading back, the command that repeats a run, --help, the manual page and docs/OPTIONS.md. So a new option
 * takes
 *   - a row here, or in the file of the part of training that it belongs to (src/parts); `use` names the
 *   commands that take it, and states whether the bytes of the result depend on it (RESULT), and where it
 *     does not apply: in a refinement (NOT_REFINED), in several blocks (ONE_BLOCK);
 *   - a field in oceanxl.h or oceanxl_job.h (while it is tried out: a place of train.experimental), and the code in
 *     src/ that reads it;
 *   - `make man`, and a test.
 *
 * Invariants: row 0 is the preset, row 1 --iterations. The text that oxl_option_get writes is read back by
 * oxl_option_set to the same bits. Text does not depend on the locale.
 */
#include "option_rows.h"

/* ---------------- the table */

enum { OPTIONS_ITERATIONS = 1 }; /* the row that sets iterations_for, too */
/* images that the presets' iterations are for: draft's and standard's, paper's */
enum { OPTIONS_IMAGES = 170, OPTIONS_IMAGES_PAPER = 2800 };
#define OPTION_BYTES_MAX 1e15
#define OPTION_SEED_MAX 9007199254740992.0 /* 2^53: a double holds all below it */

/* clang-format off */
static const oxl_option OPTIONS[] = {
/* name, value, kind, field, lowest, highest, default, tier, use, group, help */
{"preset", "draft|standard|paper", OXL_OPTION_PRESET, OPTION_AT(preset), 0, 0, PRESETS("draft", "standard", "paper"), OXL_TIER_BASIC, TRAINING, "Training", "sets the defaults of all other options. draft: fast; standard: longer; paper: the paper's method (balanced cuts, depth weights, pruning to half, second lobes on a selection)"},
{"iterations", "N", OXL_OPTION_INT, OPTION_AT(train.iterations), 1, INT_MAX, PRESETS("1200", "3000", "40000"), OXL_TIER_BASIC, TRAINING | RESULT, "Training", "training steps, one image each; many images raise the default"},
{"max-time", "TIME", OXL_OPTION_SECONDS, OPTION_AT(train.max_seconds), 0, 1e15, EACH("0"), OXL_TIER_BASIC, RUN, "Training", "save the state and stop after this time, e.g. 90s, 20m or 8h; 0: no limit"},
{"max-gaussians", "N", OXL_OPTION_INT, OPTION_AT(train.max_gaussians), 0, INT_MAX, EACH("0"), OXL_TIER_BASIC, TRAINING | RESULT, "Training", "maximum number of Gaussians in all blocks together; 0: one per point, but 1 to 2 per 60 training pixels, or up to 10000 if that is more"},
{"seed", "S", OXL_OPTION_SEED, OPTION_AT(seed), 0, 0, EACH("0"), OXL_TIER_BASIC, RUN, "Training", "seed of all random choices; 0 means 1"},
{"ram", "SIZE", OXL_OPTION_BYTES, OPTION_AT(ram), 0, OPTION_BYTES_MAX, EACH("0"), OXL_TIER_BASIC, SURVEY | TRAINING | RESULT, "Training", "memory limit, e.g. 4G; it determines blocks, image cache and number of Gaussians; 0: the free memory"},
{"device-ram", "SIZE", OXL_OPTION_BYTES, OPTION_AT(device_ram), 0, OPTION_BYTES_MAX, EACH("0"), OXL_TIER_ADVANCED, SURVEY | TRAINING | RESULT, "Training", "memory limit of the device, e.g. 2G; it determines blocks and number of Gaussians; 0: none"},
{"from", "MODEL", OXL_OPTION_TEXT, OPTION_AT(from), 0, 0, EACH(NULL), OXL_TIER_ADVANCED, TRAINING | RESULT | ONE_BLOCK, "Training", "start from this .ply, .spz or .splat model instead of the points, with the schedule of a whole run"},
{"restart", NULL, OXL_OPTION_FLAG, OPTION_AT(restart), 0, 1, EACH("false"), OXL_TIER_BASIC, OXL_OPTION_OF_OUT, "Training", "discard the run in OUT and train from the start"},
{"force", NULL, OXL_OPTION_FLAG, OPTION_AT(scene.allow_truncated), 0, 1, EACH("false"), OXL_TIER_ADVANCED, OXL_OPTION_OF_OUT, "Training", "train although a file has fewer rows than its header states"},
{"block", "all|K", OXL_OPTION_INT, OPTION_AT(block), 0, INT_MAX, EACH("all"), OXL_TIER_ADVANCED, OXL_OPTION_OF_BLOCK, "Training", "train only block K, counted from 0; all: all unfinished blocks, then the merged model"},
{"renders", "off|on", OXL_OPTION_CHOICE, OPTION_AT(renders), 0, 1, EACH("on"), OXL_TIER_ADVANCED, OXL_OPTION_OF_BLOCK, "Training", "write images of the held-out views to OUT/renders"},
{"ssim-weight", "W", OXL_OPTION_FLOAT, OPTION_AT(train.ssim_weight), 0, 1, PRESETS("0.3", "0.2", "0.2"), OXL_TIER_EXPERT, TRAINING | RESULT, "Training", "weight of SSIM in the loss, (1-W) L1 + W (1-SSIM)"},
{"images", "FOLDER", OXL_OPTION_TEXT, OPTION_AT(scene.images), 0, 0, EACH(NULL), OXL_TIER_BASIC, SURVEY | RESULT, "Input", "image folder; otherwise SCENE/images"},
{"sparse", "FOLDER|FILE", OXL_OPTION_TEXT, OPTION_AT(scene.sparse), 0, 0, EACH(NULL), OXL_TIER_ADVANCED, SURVEY | RESULT, "Input", "folder with cameras, images and points3D (.txt or .bin), or a file of points to use (.txt, .bin or .ply); otherwise SCENE/sparse/0, SCENE/sparse or SCENE"},
{"masks", "FOLDER", OXL_OPTION_TEXT, OPTION_AT(scene.masks), 0, 0, EACH(NULL), OXL_TIER_BASIC, SURVEY | RESULT, "Input", "mask folder, whose black pixels are ignored; otherwise SCENE/masks if it exists"},
{"auto-mask", "off|on", OXL_OPTION_CHOICE, OPTION_AT(scene.auto_mask), 0, 1, EACH("on"), OXL_TIER_ADVANCED, SURVEY | RESULT, "Input", "mask pixels that look the same in all images of a camera: the edge of a lens port, black borders, text, a mount"},
{"alpha", "auto|composite|mask", OXL_OPTION_CHOICE, OPTION_AT(scene.alpha), 0, 2, EACH("auto"), OXL_TIER_ADVANCED, SURVEY | RESULT, "Input", "transparent pixels of images: composited over --background, or ignored; auto: ignored where points of the scene project onto them"},
{"background", "auto|R,G,B", OXL_OPTION_RGB, OPTION_AT(train.background), 0, 1, EACH("auto"), OXL_TIER_ADVANCED, SURVEY | TRAINING | RESULT, "Input", "colour behind the scene, each channel 0 to 1; auto: in training, white where transparent images are composited over it, otherwise black; in other commands, the model's"},
{"max-side", "PX", OXL_OPTION_INT, OPTION_AT(scene.max_side), 0, INT_MAX, EACH("1600"), OXL_TIER_BASIC, SURVEY | RESULT, "Input", "reduce images so that the longer side has at most this many pixels; 0: full size"},
{"test-every", "auto|N", OXL_OPTION_INT, OPTION_AT(scene.test_every), 0, INT_MAX, EACH("auto"), OXL_TIER_BASIC, SURVEY | RESULT, "Input", "hold out every N-th view by name for evaluation; 0: none; auto: 8, or the split that the survey's files define"},
{"image-cache", "SIZE", OXL_OPTION_BYTES, OPTION_AT(scene.image_cache_bytes), 0, OPTION_BYTES_MAX, EACH("1G"), OXL_TIER_ADVANCED, SURVEY, "Input", "memory for decoded images, e.g. 512M or 4G; the others are stored in OUT/blocks/decoded until the run ends"},
{"missing-images", "FRACTION", OXL_OPTION_DOUBLE, OPTION_AT(scene.missing_images), 0, 1, EACH("0.3"), OXL_TIER_EXPERT, SURVEY, "Input", "fail if more than this fraction of the images are missing on disk"},
{"block-points", "N", OXL_OPTION_INT, OPTION_AT(partition.block_points), 0, INT_MAX, PRESETS("0", "0", "40000"), OXL_TIER_EXPERT, TRAINING | RESULT, "Blocks", "cut blocks with more sparse points than this; 0: as memory requires"},
{"blocks", "N", OXL_OPTION_INT, OPTION_AT(partition.blocks), 0, 100000, EACH("0"), OXL_TIER_ADVANCED, TRAINING | RESULT, "Blocks", "cut into this many blocks, e.g. one per machine; 0: as memory requires"},
{"partition", "auto|2d|3d|none", OXL_OPTION_CHOICE, OPTION_AT(partition.kind), 0, 3, EACH("auto"), OXL_TIER_ADVANCED, TRAINING | RESULT, "Blocks", "axes along which blocks are cut; 2d: the first two principal axes; 3d: all three; auto: 2d for a flat survey; none: one block"},
{"cut", "balanced|midpoint", OXL_OPTION_CHOICE, OPTION_AT(partition.cut), 0, 1, EACH("balanced"), OXL_TIER_EXPERT, TRAINING | RESULT, "Blocks", "where blocks are cut; balanced: at equal numbers of points, which makes fewer blocks on uneven surveys; midpoint: in the middle (the baseline of ablate)"},
{"coarse", "auto|FRACTION", OXL_OPTION_FLOAT, OPTION_AT(train.coarse), 0, 1, PRESETS("auto", "0", "0"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Schedule", "train the first FRACTION of the run at half resolution; auto: 0.75 for images of 640 px and more"},
{"cooldown", "FRACTION", OXL_OPTION_FLOAT, OPTION_AT(train.cooldown), 0, 1, EACH("0.2"), OXL_TIER_ADVANCED, TRAINING | RESULT, "Schedule", "lower all learning rates to a tenth over the last FRACTION of the run; 0: none"},
{"short-run-exponent", "E", OXL_OPTION_FLOAT, OPTION_AT(train.short_run_exponent), 0, 1, PRESETS("0.45", "0.45", "0"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Schedule", "multiply the learning rates of geometry by (30000 / n)^E in runs of n < 30000 iterations, and the others as METHOD.md says (Short runs); 0: off"},
{"alpha-min", "ALPHA", OXL_OPTION_FLOAT, OPTION_AT(train.alpha_min), 0, 0.05, PRESETS("1/128", "1/128", "1/255"), OXL_TIER_ADVANCED, TRAINING | RESULT | NOT_REFINED, "Schedule", "omit contributions to a pixel that are smaller than ALPHA, in the first 0.8 of the run"},
{"lr-position", "RATE", OXL_OPTION_FLOAT, OPTION_AT(train.lr_position), 0, 1, EACH("0.00016"), OXL_TIER_EXPERT, TRAINING | RESULT, "Learning rates", "learning rate of positions at the start, relative to the scene's extent"},
{"lr-position-final", "RATE", OXL_OPTION_FLOAT, OPTION_AT(train.lr_position_final), 0, 1, EACH("0.0000016"), OXL_TIER_EXPERT, TRAINING | RESULT, "Learning rates", "learning rate of positions at the end; exponential decay in between"},
{"lr-scale", "RATE", OXL_OPTION_FLOAT, OPTION_AT(train.lr_scale), 0, 1, EACH("0.005"), OXL_TIER_EXPERT, TRAINING | RESULT, "Learning rates", "learning rate of log scales"},
{"lr-rotation", "RATE", OXL_OPTION_FLOAT, OPTION_AT(train.lr_rotation), 0, 1, EACH("0.001"), OXL_TIER_EXPERT, TRAINING | RESULT, "Learning rates", "learning rate of quaternions"},
{"lr-sh0", "RATE", OXL_OPTION_FLOAT, OPTION_AT(train.lr_sh0), 0, 1, EACH("0.0025"), OXL_TIER_EXPERT, TRAINING | RESULT, "Learning rates", "learning rate of base colours"},
{"lr-sh", "RATE", OXL_OPTION_FLOAT, OPTION_AT(train.lr_sh), 0, 1, EACH("0.0025/20"), OXL_TIER_EXPERT, TRAINING | RESULT, "Learning rates", "learning rate of SH above degree 0"},
{"densify-gradient", "T", OXL_OPTION_FLOAT, OPTION_AT(train.densify_gradient), 0, 1e15, PRESETS("0.00055", "0.0002", "0.0002"), OXL_TIER_ADVANCED, TRAINING | RESULT, "Density control", "split Gaussians whose mean position gradient exceeds this, in units of half an image; at most 0.0002 for transparent images without points"},
{"densify-until", "FRACTION", OXL_OPTION_FLOAT, OPTION_AT(train.densify_until), 0, 1, EACH("0.5"), OXL_TIER_EXPERT, TRAINING | RESULT | NOT_REFINED, "Density control", "fraction of the run at which densification ends"},
{"densify-every", "auto|N", OXL_OPTION_INT, OPTION_AT(train.densify_every), 1, INT_MAX, PRESETS("auto", "100", "100"), OXL_TIER_EXPERT, TRAINING | RESULT, "Density control", "iterations between densifications; auto: a tenth of the run, 15 to 50"},
};
/* clang-format on */

int oxl_option_count(void)
{
    int count = 0;
    while (oxl_option_at(count)) count++;
    return count;
}

const oxl_option *oxl_option_at(int index)
{
    return index < (int)OXL_COUNT(OPTIONS) ? &OPTIONS[index] : parts_option(index - (int)OXL_COUNT(OPTIONS));
}

/* Names a field as in the struct that holds it: "max_side", but "partition.cut". */
static const char *option_field(const oxl_option *o)
{
    return o->field + (strcspn(o->field, ".") == 5 ? 6 : 0); /* "train." and "scene." have 6 letters */
}

OXL_INTERNAL void option_name_fields(char *text, size_t size)
{
    char rest[OXL_SURVEY_TEXT];
    for (char *at = text; (at = strstr(at, "--")) != NULL; at += 2) {
        char *end = at + 2 + strspn(at + 2, "abcdefghijklmnopqrstuvwxyz-");
        const oxl_option *o;
        snprintf(rest, sizeof rest, "%s", end);
        *end = 0;
        o = oxl_option_find(at + 2);
        *end = rest[0];
        if (o) snprintf(at, size - (size_t)(at - text), "%s%s", option_field(o), rest);
    }
}

const oxl_option *oxl_option_find(const char *name)
{
    const oxl_option *o;
    for (int i = 0; (o = oxl_option_at(i)) != NULL; i++)
        if (strcmp(o->name, name) == 0) return o;
    return NULL;
}

/* Writes an option's name for run.json: dashes become underscores, and folders get the suffix _folder, since
 * "images" is a count there. */
const char *oxl_option_member(const oxl_option *option, char out[40])
{
    snprintf(out, 40, "%s%s", option->name,
             option->kind == OXL_OPTION_TEXT && option->value && !strcmp(option->value, "FOLDER") ? "_folder"
                                                                                                  : "");
    for (char *c = out; *c; c++)
        if (*c == '-') *c = '_';
    return out;
}

/* ---------------- defaults */

oxl_job_options oxl_job_options_default(oxl_preset preset)
{
    oxl_job_options o = {.scene = {.read_images = 1}};
    const oxl_option *row;
    if (preset < OXL_PRESET_DRAFT || preset > OXL_PRESET_PAPER) { /* refused by every check */
        o = oxl_job_options_default(OXL_PRESET_DRAFT);
        o.preset = "unknown";
        o.train.iterations = 0;
        return o;
    }
    o.preset = OPTIONS[0].preset[preset];
    for (int i = 1; (row = oxl_option_at(i)) != NULL; i++)
        if (row->preset[preset]) oxl_option_set(row, &o, row->preset[preset], NULL, 0);
    o.iterations_for = preset == OXL_PRESET_PAPER ? OPTIONS_IMAGES_PAPER : OPTIONS_IMAGES;
    return o;
}

oxl_train_options oxl_train_options_default(oxl_preset preset)
{
    return oxl_job_options_default(preset).train;
}

oxl_scene_options oxl_scene_options_default(void)
{
    return oxl_job_options_default(OXL_PRESET_DRAFT).scene;
}

/* ---------------- text to a value */

/* Letters of the word that a number's value begins with, as in auto|FRACTION; 0: there is none. */
static size_t option_word(const oxl_option *o)
{
    const size_t length = o->value ? strcspn(o->value, "|") : 0;
    return length > 0 && o->value[length] && o->value[0] >= 'a' ? length : 0;
}

/* Parses a number without a sign at *text, which moves past it; not 1.#IND. */
static int option_unsigned(const char **text, double *out)
{
    return ((unsigned char)(**text - '0') < 10 || **text == '.') &&
           parse_double(text, *text + strlen(*text), out) && !isnan(*out);
}

/* Lists units: their words, between blanks, and their sizes. */
struct option_unit {
    const char *words;
    double size;
};
static const struct option_unit OPTION_COUNTS[] = {{" k ", 1e3}, {" m ", 1e6}, {NULL, 0}},
                                OPTION_BYTES[] = {{" b ", 1},
                                                  {" k kb kib ", 1024.},
                                                  {" m mb mib ", 1048576.},
                                                  {" g gb gib ", 1073741824.},
                                                  {" t tb tib ", 1099511627776.},
                                                  {NULL, 0}},
                                OPTION_FILE[] = {{" b ", 1}, /* decimal, as file sizes are printed */
                                                 {" k kb ", 1e3},  {" ki kib ", 1024.},
                                                 {" m mb ", 1e6},  {" mi mib ", 1048576.},
                                                 {" g gb ", 1e9},  {" gi gib ", 1073741824.},
                                                 {" t tb ", 1e12}, {" ti tib ", 1099511627776.},
                                                 {NULL, 0}},
                                OPTION_SECONDS[] = {{" s sec secs second seconds ", 1},
                                                    {" m min mins minute minutes ", 60},
                                                    {" h hr hrs hour hours ", 3600},
                                                    {" d day days ", 86400},
                                                    {NULL, 0}};

/* Parses a number, or a sum of numbers with units, with blanks or without: 4G, "4 GB", 1h30m. */
static int option_quantity(const char *text, const struct option_unit *units, double *out)
{
    double sum = 0, value;
    for (int parts = 0;; parts++) {
        const struct option_unit *unit = units;
        char word[16] = " ";
        size_t n = 1;
        if (!option_unsigned(&text, &value)) return 0;
        text += strspn(text, " ");
        for (; (*text | 0x20) >= 'a' && (*text | 0x20) <= 'z' && n < 14; text++)
            word[n++] = (char)(*text | 0x20);
        word[n] = ' ';
        text += strspn(text, " ");
        if (n == 1 && (parts || *text)) return 0;
        while (n > 1 && unit->words && !strstr(unit->words, word)) unit++;
        if (n > 1 && !unit->words) return 0;
        sum += n > 1 ? value * unit->size : value;
        if (!*text) return *out = sum, 1;
    }
}

static int option_whole(const char *text, double *out)
{
    return text[strspn(text, "0123456789")] == 0 && option_unsigned(&text, out);
}

/* Parses 0.004, or 1/255: the quotient of two floats. */
static int option_fraction(const char *text, float *out)
{
    double above, below = 1;
    if (!option_unsigned(&text, &above)) return 0;
    if (*text == '/' && (text++, !option_unsigned(&text, &below))) return 0;
    *out = (float)OXL_MIN(above, FLT_MAX) / (float)OXL_MIN(below, FLT_MAX);
    return *text == 0;
}

/* Parses "X,Y,Z". */
static int option_three(const char *text, double out[3])
{
    double v[3];
    for (int k = 0; k < 3; k++) {
        const int minus = *text == '-';
        text += minus;
        if (!option_unsigned(&text, &v[k]) || *text != (k < 2 ? ',' : 0) || !(v[k] <= 1e15)) return 0;
        if (minus) v[k] = -v[k];
        text++;
    }
    memcpy(out, v, sizeof v);
    return 1;
}

static int option_read_rgb(const oxl_option *o, const char *text, float *out)
{
    double v[3] = {-1, -1, -1};
    if (!option_word(o) || strcmp(text, "auto")) {
        if (!option_three(text, v)) return 0;
        for (int k = 0; k < 3; k++)
            if (!(v[k] >= o->low && v[k] <= o->high)) return 0;
    }
    for (int k = 0; k < 3; k++) out[k] = (float)v[k];
    return 1;
}

/* Parses "400x260". */
static int option_read_size(const oxl_option *o, const char *text, int *out)
{
    double v[2];
    const char *x = text + strspn(text, "0123456789");
    if (!option_unsigned(&text, &v[0]) || text != x || *x != 'x' || !option_whole(x + 1, &v[1])) return 0;
    if (!(v[0] >= o->low && v[1] >= o->low && v[0] <= o->high && v[1] <= o->high)) return 0;
    out[0] = (int)v[0], out[1] = (int)v[1];
    return 1;
}

/* Finds the word among "one|two|three": its index. */
static int option_choice(const char *words, const char *text, int *out)
{
    for (int i = 0; *words; i++) {
        const size_t length = strcspn(words, "|");
        if (strlen(text) == length && strncmp(words, text, length) == 0) return *out = i, 1;
        words += length + (words[length] != 0);
    }
    return 0;
}

OXL_INTERNAL int option_read_keep(const char *text, oxl_keep *out)
{
    double value;
    oxl_keep_kind kind = OXL_KEEP_BYTES;
    if (strcmp(text, "all") == 0) return *out = (oxl_keep){OXL_KEEP_ALL, 0}, 1;
    if (!option_quantity(text, OPTION_FILE, &value) || !(value > 0 && value <= OPTION_BYTES_MAX)) return 0;
    if (text[strspn(text, "0123456789.eE+-")] == 0)
        kind = value < 1 ? OXL_KEEP_FRACTION : value > 1 ? OXL_KEEP_COUNT : OXL_KEEP_ALL;
    *out = (oxl_keep){kind, kind == OXL_KEEP_COUNT ? floor(value) : kind == OXL_KEEP_ALL ? 0 : value};
    return 1;
}

static int option_read_preset(const oxl_option *o, const char *text, void *options)
{
    int preset;
    if (!option_choice(o->value, text, &preset)) return 0;
    *(oxl_job_options *)options = oxl_job_options_default((oxl_preset)preset);
    return 1;
}

/* Numbers that have a range, as a double; -1 for the word. */
static int option_read_number(const oxl_option *o, const char *text, double *out)
{
    const size_t word = option_word(o);
    float single = 0;
    int is_one = 0;
    if (word > 0 && strlen(text) == word && strncmp(text, o->value, word) == 0) return *out = -1, 1;
    switch (o->kind) {
    case OXL_OPTION_SEED: return option_whole(text, out) && *out < OPTION_SEED_MAX;
    case OXL_OPTION_INT:
        is_one = option_whole(text, out) ||
                 (option_quantity(text, OPTION_COUNTS, out) && *out == floor(*out) && strpbrk(text, "kKmM"));
        break;
    case OXL_OPTION_BYTES: is_one = option_quantity(text, OPTION_BYTES, out); break;
    case OXL_OPTION_SECONDS: is_one = option_quantity(text, OPTION_SECONDS, out); break;
    case OXL_OPTION_FLOAT:
        is_one = option_fraction(text, &single);
        *out = single;
        return is_one && single >= (float)o->low && single <= (float)o->high;
    default: is_one = option_quantity(text, &OPTION_COUNTS[2], out); /* no unit */
    }
    return is_one && *out >= o->low && *out <= o->high;
}

static int option_read(const oxl_option *o, const char *text, void *options)
{
    void *const field = (char *)options + o->at;
    double v;
    switch (o->kind) {
    case OXL_OPTION_FLAG:
        return strcmp(text, "true") && strcmp(text, "false") ? 0 : (*(int *)field = text[0] == 't', 1);
    case OXL_OPTION_TEXT: return text[0] ? (*(const char **)field = text, 1) : 0;
    case OXL_OPTION_CHOICE: return option_choice(o->value, text, field);
    case OXL_OPTION_RGB: return option_read_rgb(o, text, field);
    case OXL_OPTION_POINT: return option_three(text, field);
    case OXL_OPTION_SIZE: return option_read_size(o, text, field);
    case OXL_OPTION_PRESET: return option_read_preset(o, text, options);
    case OXL_OPTION_KEEP: return option_read_keep(text, field);
    default: break;
    }
    if (!option_read_number(o, text, &v)) return 0;
    switch (o->kind) {
    case OXL_OPTION_INT:
        *(int *)field = (int)v;
        if (o == &OPTIONS[OPTIONS_ITERATIONS]) ((oxl_job_options *)options)->iterations_for = 0;
        break;
    case OXL_OPTION_SEED: *(uint64_t *)field = (uint64_t)v; break;
    case OXL_OPTION_FLOAT: *(float *)field = (float)v; break;
    case OXL_OPTION_BYTES: *(size_t *)field = (size_t)OXL_MIN(v, (double)(SIZE_MAX / 2)); break;
    default: *(double *)field = v;
    }
    return 1;
}

/* ---------------- what is wrong with a text */

static void option_describe_range(const oxl_option *o, char out[160])
{
    char low[NUMBER_TEXT_MAX], high[NUMBER_TEXT_MAX];
    char word[32] = "";
    format_shortest(low, o->low);
    format_shortest(high, o->high);
    if (option_word(o)) snprintf(word, sizeof word, "%.*s or ", (int)option_word(o), o->value);
    switch (o->kind) {
    case OXL_OPTION_INT:
    case OXL_OPTION_FLOAT:
    case OXL_OPTION_DOUBLE:
        snprintf(out, 160, "%sa %snumber from %s to %s", word, o->kind == OXL_OPTION_INT ? "whole " : "", low,
                 high);
        break;
    case OXL_OPTION_SIZE: snprintf(out, 160, "WxH, each from %s to %s", low, high); break;
    case OXL_OPTION_SEED: snprintf(out, 160, "a whole number below 2^53"); break;
    case OXL_OPTION_BYTES: snprintf(out, 160, "a size, e.g. 512M or 4G"); break;
    case OXL_OPTION_SECONDS: snprintf(out, 160, "a time, e.g. 90s, 20m or 8h"); break;
    default: snprintf(out, 160, "%s", o->value ? o->value : "no value");
    }
}

/* The fix never is 0, which for a limit is none. */
static void option_describe_error(const oxl_option *o, const char *text, char *error, size_t size)
{
    const char *dashes = o->name[1] ? "--" : "-", *example = o->preset[0];
    char wanted[160];
    option_describe_range(o, wanted);
    if (!example || !strcmp(example, "0"))
        example = o->kind == OXL_OPTION_BYTES     ? "4G"
                  : o->kind == OXL_OPTION_SECONDS ? "90m"
                  : o->value                      ? o->value
                                                  : "";
    snprintf(error, size, "option %s%s: found '%.80s', expected %s\nfix: %s%s %s", dashes, o->name, text,
             wanted, dashes, o->name, example);
}

oxl_result oxl_option_set(const oxl_option *option, void *options, const char *text, char *error,
                          size_t error_size)
{
    if (option_read(option, text ? text : "true", options)) return OXL_OK;
    if (error) option_describe_error(option, text ? text : "nothing", error, error_size);
    return OXL_ERR_USAGE;
}

/* ---------------- a value to text */

static void option_get_keep(const oxl_keep *keep, char *out, size_t size)
{
    char digits[NUMBER_TEXT_MAX];
    format_shortest(digits, keep->value);
    switch (keep->kind) {
    case OXL_KEEP_ALL: snprintf(out, size, "all"); break;
    case OXL_KEEP_BYTES: snprintf(out, size, "%sB", digits); break;
    default: snprintf(out, size, "%s", digits);
    }
}

static void option_get_bytes(size_t bytes, char *out, size_t size)
{
    static const char units[] = " KMGT";
    int unit = 0;
    while (bytes > 0 && bytes % 1024 == 0 && unit < 4) bytes /= 1024, unit++;
    snprintf(out, size, unit ? "%zu%c" : "%zu", bytes, units[unit]);
}

static void option_get_choice(const char *words, int choice, char *out, size_t size)
{
    int left = choice;
    for (; left > 0 && *words; left--) words += strcspn(words, "|") + (words[strcspn(words, "|")] != 0);
    if (left || !*words) snprintf(out, size, "%d", choice);
    else snprintf(out, size, "%.*s", (int)strcspn(words, "|"), words);
}

static void option_get_three(const double v[3], int single, char *out, size_t size)
{
    char t[3][NUMBER_TEXT_MAX];
    for (int k = 0; k < 3; k++)
        if (single) format_float(t[k], (float)v[k]);
        else format_shortest(t[k], v[k]);
    snprintf(out, size, "%s,%s,%s", t[0], t[1], t[2]);
}

static void option_get_number(const oxl_option *o, const void *field, char *out, size_t size)
{
    const double v = o->kind == OXL_OPTION_INT     ? *(const int *)field
                     : o->kind == OXL_OPTION_SEED  ? (double)*(const uint64_t *)field
                     : o->kind == OXL_OPTION_FLOAT ? (double)*(const float *)field
                                                   : *(const double *)field;
    char digits[NUMBER_TEXT_MAX];
    if (v == -1 && option_word(o)) {
        snprintf(out, size, "%.*s", (int)option_word(o), o->value);
        return;
    }
    if (o->kind == OXL_OPTION_FLOAT) format_float(digits, (float)v);
    else format_shortest(digits, v);
    snprintf(out, size, "%s", digits);
}

const char *oxl_option_get(const oxl_option *o, const void *options, char *out, size_t size)
{
    const void *field = (const char *)options + o->at;
    const float *f = field;
    switch (o->kind) {
    case OXL_OPTION_FLAG: snprintf(out, size, *(const int *)field ? "true" : "false"); break;
    case OXL_OPTION_PRESET:
    case OXL_OPTION_TEXT:
        snprintf(out, size, "%s", *(const char *const *)field ? *(const char *const *)field : "");
        break;
    case OXL_OPTION_CHOICE: option_get_choice(o->value, *(const int *)field, out, size); break;
    case OXL_OPTION_BYTES: option_get_bytes(*(const size_t *)field, out, size); break;
    case OXL_OPTION_RGB:
        if (option_word(o) && f[0] == -1 && f[1] == -1 && f[2] == -1) snprintf(out, size, "auto");
        else option_get_three((const double[3]){f[0], f[1], f[2]}, 1, out, size);
        break;
    case OXL_OPTION_POINT: option_get_three(field, 0, out, size); break;
    case OXL_OPTION_SIZE:
        snprintf(out, size, "%dx%d", ((const int *)field)[0], ((const int *)field)[1]);
        break;
    case OXL_OPTION_KEEP: option_get_keep(field, out, size); break;
    default: option_get_number(o, field, out, size);
    }
    return out;
}

/* ---------------- all options */

OXL_INTERNAL void options_drop(oxl_train_options *train, unsigned flag)
{
    oxl_job_options job = {.train = *train};
    const oxl_option *row;
    for (int i = 1; (row = oxl_option_at(i)) != NULL; i++) {
        const char *off = row->kind == OXL_OPTION_KEEP ? "all" : row->kind == OXL_OPTION_CHOICE ? "off" : "0";
        if (row->use & flag) oxl_option_set(row, &job, off, NULL, 0);
    }
    *train = job.train;
}

/* Accepts values whose printed text parses again, which is where the ranges are checked. */
oxl_result oxl_job_options_check(oxl_context *ctx, const oxl_job_options *options)
{
    oxl_job_options read = *options;
    char text[128], wanted[160];
    const oxl_option *row;
    for (int i = 1; (row = oxl_option_at(i)) != NULL; i++) {
        if (row->kind == OXL_OPTION_TEXT) continue;
        oxl_option_get(row, options, text, sizeof text);
        if (oxl_option_set(row, &read, text, NULL, 0) == OXL_OK) continue;
        option_describe_range(row, wanted);
        return oxl_fail(ctx, OXL_ERR_USAGE, "%s is %s, expected %s\nfix: the default is %s",
                        option_field(row), text, wanted, row->preset[0] ? row->preset[0] : "0");
    }
    return OXL_OK;
}

oxl_result oxl_train_options_check(oxl_context *ctx, const oxl_train_options *options)
{
    oxl_job_options job = oxl_job_options_default(OXL_PRESET_DRAFT);
    job.train = *options;
    return oxl_job_options_check(ctx, &job);
}
