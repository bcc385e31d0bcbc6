/* options.c - holds two tables: the commands, and the options that are the program's alone.
 *
 * The options of a training job are the library's (src/core/options.c). Both tables have the same type of
 * row, and parsing, help, the manual page and docs/OPTIONS.md are made from both.
 *
 * Invariant: an option that is in neither table is an error. Nothing is ignored silently.
 */
#include "cli.h"

#include <stddef.h>
#include <string.h>

#define CLI_COUNT(array) ((int)(sizeof(array) / sizeof *(array)))
#define IN(command) (1u << COMMAND_##command)

const struct cli_command CLI_COMMANDS[COMMANDS] = {
    [COMMAND_TRAIN] =
        {"train", 1, 1, "SCENE -o OUT", "Trains a survey: images and a COLMAP model in, one splat model out.",
         "oceanxl train survey -o out",
         "OUT gets scene.ply (scene_standard.ply if other viewers need it; scene_clear.ply and imaging.txt with exposure, lamp or water), report.html, metrics.json, run.json, renders/ of held-out views, training_views/ and blocks/KKK/.\n"
         "Ctrl-C saves the state and stops; a crash loses at most a minute of training. The same command resumes."},
    [COMMAND_CHECK] = {"check", 1, 0, "SCENE",
                       "Checks a survey: prints what train would read, and the predicted memory and time.",
                       "oceanxl check survey",
                       "Exit code 3 means that the survey cannot be trained; the message gives the reason."},
    [COMMAND_RENDER] =
        {"render", 2, 1, "MODEL SCENE -o DIR",
         "Renders a model from the cameras of a survey; with --ortho, as an orthomosaic with heights; with --flight, along a path.",
         "oceanxl render out/scene.ply survey -o renders",
         "Writes one PNG per view, named after its image. With --ortho, writes a map as GeoTIFF instead; with --flight, numbered frames."},
    [COMMAND_CLOUD] =
        {"cloud", 2, 1, "MODEL SCENE -o FILE",
         "Writes points on the surface that the training views agree on, or triangles with --mesh.",
         "oceanxl cloud out/scene.ply survey -o cloud.las",
         "FILE is .ply or .las (.ply or .obj with --mesh), in the survey's world coordinates; in metres with --scale."},
    [COMMAND_COMPARE] =
        {"compare", 2, 1, "OUT1 OUT2 -o DIR",
         "Compares two trained surveys of one place: differences of height, volumes, significant changes.",
         "oceanxl compare dive1 dive2 -o change",
         "DIR gets compare.html (a page for a browser), compare.csv, change.png, difference.tif (with the level of detection) and significant.tif.\n"
         "Coordinates are those of the first survey; --gps takes the positions of its photos."},
    [COMMAND_MEASURE] =
        {"measure", 1, 0, "SCENE --scale-bar ENDS",
         "Measures in a survey: the length of a scale bar, and from it metres per unit.",
         "oceanxl measure survey --scale-bar a.jpg,410,300,b.jpg,95,310:a.jpg,700,320,b.jpg,390,333 --length 0.5",
         "Pixels are those of the original images; the centre of the top-left pixel is 0.5,0.5. Give the scale to render and convert."},
    [COMMAND_EVAL] =
        {"eval", 2, 0, "MODEL SCENE",
         "Compares a model with images: PSNR, cc-PSNR (without exposure) and SSIM, for each view and on average.",
         "oceanxl eval out/scene.ply survey",
         "The images are those that train held out, unless --split says otherwise.\n"
         "examples/lpips.py compares the renders of a run with their images by LPIPS."},
    [COMMAND_INFO] =
        {"info", 1, 0, "FILE",
         "Prints the number of Gaussians in a model file, and where they are, how large and how opaque.",
         "oceanxl info out/scene.ply", "Reads .ply, .spz and .splat."},
    [COMMAND_CONVERT] =
        {"convert", 2, 0, "IN OUT", "Converts between .ply, .spz and .splat by the files' extensions.",
         "oceanxl convert out/scene.ply scene.splat",
         ".spz is the smallest; .splat holds 32 bytes per Gaussian and no view-dependent colour."},
    [COMMAND_REPORT] =
        {"report", 1, 0, "OUT", "Writes a page about a run: its input, decisions and metrics.",
         "oceanxl report out",
         "OUT gets report.html: one file, for a screen, a phone or paper, that needs no network. train writes it too, at its end, in the survey's unit."},
    [COMMAND_SYNTH] =
        {"synth", 0, 1, "-o DIR",
         "Makes a synthetic underwater survey with known truth, as a COLMAP text export.",
         "oceanxl synth -o survey",
         "DIR gets images/, sparse/0/ and truth/: images without water, depth maps, the water's parameters."},
    [COMMAND_ABLATE] =
        {"ablate", 1, 1, "SCENE -o OUT",
         "Trains the variants of the OceanXL paper, and measures the gain and cost of each part.",
         "oceanxl ablate survey -o ablation --preset standard --seeds 3",
         "OUT gets ablate.md (tables), ablate.csv, and for each row and seed a run of train, in SCENE/ROW-seedS/. The same command\n"
         "resumes a stopped study. All rows share the options below. Rows: 3dgs (midpoint cuts), v1 (+BSP, balanced cuts), v2 (+UCD, depth weights), v3 (+WAP, half pruned), v4\n"
         "(+DoG, second lobes on all), oceanxl (second lobes on a selection); controls: v1-count (V1 with as many Gaussians as V2), v3-bytes (V3 with the bytes of OceanXL)."},
    [COMMAND_TRADEOFF] =
        {"tradeoff", 1, 1, "SCENE -o OUT",
         "Measures speed against accuracy on a survey: options one at a time, and the presets.",
         "oceanxl tradeoff survey -o tradeoff --budget 20m",
         "OUT gets tradeoff.md (tables), tradeoff.csv, and a run for each row and seed, in SCENE/ROW-seedS/. Rows that do\n"
         "not fit the budget are named; the same command with a larger one trains them, too."},
    [COMMAND_RESULTS] =
        {"results", 1, 1, "SURVEY... -o OUT",
         "Measures the figures in the documents: speed, the paper's parts, light and water, blocks, extremes, published scenes.",
         "oceanxl results survey1 survey2 lego -o results --max-side 240",
         "OUT gets results.md (tables), results.csv, both with the commit, and the runs. Scenes in the layout of NeRF\n"
         "synthetic or LLFF are trained with draft, with standard, and with standard for 30,000 iterations instead. The budget is ten minutes by default; a release takes --budget 24h\n"
         "--seeds 3. The same command resumes a stopped study."},
};

/* ---------------- options of the program */

#define STUDIES (IN(ABLATE) | IN(TRADEOFF) | IN(RESULTS))
/* Commands that accept all options of train, with or without effect, so that only
 * the command's name changes. */
#define TRAINS (IN(TRAIN) | IN(CHECK))
#define DRAWS (IN(TRAIN) | IN(CHECK) | IN(RENDER) | IN(CLOUD) | IN(COMPARE) | IN(EVAL) | STUDIES)
#define EVERYWHERE (~0u)
#define LEAST 1e-9 /* Limits, in metres, a length that may not be 0. */
#define MOST 1e15  /* Limits plausible values, in metres or seconds. */
/* Makes a row of what differs between the options of the program: none has presets. */
#define ROW(name, value, kind, field, low, high, tier, use, group, help)                           \
    {                                                                                              \
        name, value, OXL_OPTION_##kind, offsetof(struct arguments, field), #field, low, high, {0}, \
            OXL_TIER_##tier, use, group, help                                                      \
    }

/* Lists the program's options. arguments_default has their defaults; `use` has a bit for each command. */
/* clang-format off */
static const oxl_option CLI_OPTIONS[] = {
/* name, value, kind, field, lowest, highest, tier, commands, group, help */
ROW("rows", "NAME,NAME...", TEXT, rows, 0, 0, BASIC, IN(ABLATE) | IN(TRADEOFF), "Study", "rows to train; otherwise, ablate: 3dgs,v1,v2,v1-count,v3,v4,oceanxl,v3-bytes, each control after its row; tradeoff: all, compared with the base"),
ROW("seeds", "N", INT, seeds, 1, CLI_SEEDS, BASIC, STUDIES, "Study", "train each row with seeds 1 to N"),
ROW("budget", "TIME", SECONDS, budget, 0.001, MOST, BASIC, IN(TRADEOFF) | IN(RESULTS), "Study", "time for all rows, e.g. 90s, 20m or 8h; otherwise 20m, or 10m for results"),
ROW("views", "N", INT, synth.views, 2, 1000000, BASIC, IN(SYNTH), "Synthetic survey", "number of images"),
ROW("size", "WxH", SIZE, synth.width, 16, 8192, BASIC, IN(SYNTH), "Synthetic survey", "size of an image, 16 to 8192 px a side"),
ROW("path", "lawnmower|orbit|forward", CHOICE, synth.path, 0, 2, BASIC, IN(SYNTH), "Synthetic survey", "camera path; forward: one line, looking ahead and down"),
ROW("layout", "colmap|nerf|llff", CHOICE, synth.layout, 0, 2, BASIC, IN(SYNTH), "Synthetic survey", "layout of the files"),
ROW("extent", "METRES", DOUBLE, synth.extent, 0, 2000, BASIC, IN(SYNTH), "Synthetic survey", "side of the area, or diameter of the orbit; 0: as the overlap requires"),
ROW("exposure-jitter", "STOPS", DOUBLE, synth.exposure_jitter, 0, 4, BASIC, IN(SYNTH), "Synthetic survey", "largest change of the images' brightness along the path"),
ROW("lamp", "POWER", DOUBLE, synth.lamp, 0, 2, BASIC, IN(SYNTH), "Synthetic survey", "a lamp at the camera that falls off with this power of the range; otherwise none"),
ROW("backscatter", "FRACTION", DOUBLE, synth.backscatter, 0, 1, BASIC, IN(SYNTH), "Synthetic survey", "largest backscatter of --lamp, as a fraction of full white"),
ROW("sand-contrast", "FRACTION", DOUBLE, synth.sand_contrast, 0, 1, BASIC, IN(SYNTH), "Synthetic survey", "contrast of bare sand, as a fraction of its usual contrast; below 1 it is dark and has few points"),
ROW("stereo", "METRES", DOUBLE, synth.stereo, 0, 10, BASIC, IN(SYNTH), "Synthetic survey", "distance between two cameras that take the images in pairs; 0: one camera"),
ROW("change", "none|light|all", CHOICE, synth.change, 0, 2, BASIC, IN(SYNTH), "Synthetic survey", "make a second dive at the same place (same seed), with other cameras, sun and noise; all: also with one mound more and one stone less (truth/change.txt)"),
ROW("water", "none|I|IA|IB|II|III|1C|3C|5C|7C|9C", CHOICE, synth.water, 0, 10, BASIC, IN(SYNTH), "Synthetic survey", "Jerlov's water type"),
ROW("pose-noise", "X", DOUBLE, synth.pose_noise, 0, 10, ADVANCED, IN(SYNTH), "Synthetic survey", "turn exported poses by X degrees, move them by X % of the points' distance (rms); truth/poses.txt has the true ones"),
ROW("noise", "SIGMA", DOUBLE, synth.noise, 0, 100, BASIC, IN(SYNTH), "Synthetic survey", "sensor noise, standard deviation in 8-bit levels"),
ROW("alpha", "METRES", DOUBLE, synth.alpha, 0, 2000, BASIC, IN(SYNTH), "Synthetic survey", "keep only what lies within this distance of the centre; images are transparent elsewhere; 0: keep all"),
ROW("points", "N", INT, synth.points, 0, 100000000, BASIC, IN(SYNTH), "Synthetic survey", "number of sparse points; 0: 400 per view"),
ROW("origin", "X,Y,Z", POINT, synth.origin, 0, 0, BASIC, IN(SYNTH), "Synthetic survey", "world coordinates of the centre, metres"),
ROW("seed", "S", SEED, synth.seed, 0, 0, BASIC, IN(SYNTH), "Synthetic survey", "seed of all random choices"),
ROW("no-images", NULL, FLAG, no_images, 0, 1, BASIC, IN(SYNTH), "Synthetic survey", "write only the COLMAP model, for load tests"),
ROW("scale-bar", "ENDS", TEXT, bar, 0, 0, BASIC, IN(MEASURE), "Measurement", "ends of the bar: IMG1,X,Y,IMG2,X,Y:IMG1,X,Y,IMG2,X,Y, each end in two or more images; or X,Y,Z:X,Y,Z in the survey's units; several as ENDS=METRES;ENDS=METRES"),
ROW("length", "METRES", DOUBLE, length, LEAST, MOST, BASIC, IN(MEASURE), "Measurement", "known length of the bar"),
ROW("split", "test|train|all", CHOICE, split, 0, 2, BASIC, IN(RENDER) | IN(EVAL), "Views", "views to use"),
ROW("depth", NULL, FLAG, depth, 0, 1, BASIC, IN(RENDER), "Views", "also write depth: NAME.depth.png for viewing and NAME.depth.pfm in the survey's unit"),
ROW("clear", NULL, FLAG, clear, 0, 1, ADVANCED, IN(RENDER), "Views", "render at mean exposure and without the medium, for models with an imaging.txt beside them"),
ROW("ortho", NULL, FLAG, ortho, 0, 1, BASIC, IN(RENDER), "Views", "render a map instead: the GeoTIFF files ortho.tif (orthomosaic), height.tif (heights) and certainty.tif (their standard deviation and number of views), and frame.txt (axes)"),
ROW("pixel", "SIZE", DOUBLE, pixel, LEAST, MOST, BASIC, IN(RENDER) | IN(CLOUD) | IN(COMPARE), "Map", "pixel size in the survey's unit, or in metres with --scale; otherwise the median size of an image pixel on the ground, or twice that with --mesh"),
ROW("epsg", "CODE", INT, epsg, 0, 32766, BASIC, IN(RENDER) | IN(COMPARE) | IN(CLOUD), "Map", "the survey's projected coordinate system, for the GeoTIFF and LAS files, e.g. 32632 for UTM zone 32N"),
ROW("gps", NULL, FLAG, gps, 0, 1, BASIC, IN(RENDER) | IN(COMPARE) | IN(CLOUD), "Map", "write coordinates in metres (UTM) with z up, fitted to the GPS positions in the photos' EXIF data"),
ROW("min-views", "N", INT, min_views, 1, 1000, BASIC, IN(RENDER) | IN(COMPARE) | IN(CLOUD), "Map", "number of training views that must have seen a place; other places are transparent, have no height and are left out of clouds"),
ROW("polygon", "X,Y;X,Y;...", TEXT, polygon, 0, 0, BASIC, IN(COMPARE), "Map", "compare only within this polygon, in the map's coordinates"),
ROW("mesh", NULL, FLAG, mesh, 0, 1, BASIC, IN(CLOUD), "Map", "write triangles instead of points"),
ROW("smooth", "N", INT, smooth, 0, 1000, BASIC, IN(RENDER), "Map", "number of passes that smooth the heights within their certainty and keep edges"),
ROW("frame", "auto|world|survey", CHOICE, frame, 0, 2, ADVANCED, IN(RENDER) | IN(COMPARE), "Map", "axes: the world's x and y, seen along z, or the survey's principal axes; auto: the world's where its z is up"),
ROW("flight", "none|orbit|survey", CHOICE, flight, 0, 2, BASIC, IN(RENDER), "Views", "render the frames of a flight instead, around the centre or along the cameras: frame_00000.png, ..."),
ROW("frames", "N", INT, frames, 0, 2147483647, BASIC, IN(RENDER), "Views", "number of frames of the flight"),
ROW("scale", "METRES", DOUBLE, scale, LEAST, MOST, BASIC, IN(RENDER) | IN(COMPARE) | IN(CLOUD) | IN(CONVERT) | IN(REPORT), "Views", "metres per unit of the survey, as measure prints it; depths, heights, positions, models and the report's lengths are then in metres"),
ROW("o", "FOLDER", TEXT, out, 0, 0, BASIC, IN(TRAIN) | IN(RENDER) | IN(CLOUD) | IN(COMPARE) | IN(SYNTH) | STUDIES, "Program", "output folder, created if missing; for cloud: the output file"),
ROW("json", NULL, FLAG, json, 0, 1, BASIC, IN(CHECK) | IN(EVAL) | IN(INFO), "Program", "print results on standard output as JSON"),
ROW("quality", NULL, FLAG, quality, 0, 1, BASIC, IN(CHECK), "Program", "read every image, and name those that are more blurred, darker or brighter than their neighbours"),
ROW("control", "FILE", TEXT, control, 0, 0, BASIC, IN(CHECK), "Program", "also compare control points with the places where the cameras see them; a line is NAME,X,Y,Z,IMG,X,Y,IMG,X,Y: world coordinates, and pixels in two images or more"),
ROW("dry-run", NULL, FLAG, dry_run, 0, 1, BASIC, IN(TRAIN), "Program", "check the survey, the options and OUT, print predicted time and memory, and write nothing"),
ROW("progress", "text|json", CHOICE, progress_json, 0, 1, ADVANCED, IN(TRAIN), "Program", "form of the progress on standard error; json: JSON lines, {\"event\": \"progress\" or \"log\", ...}"),
ROW("backend", "cpu|auto|vulkan", CHOICE, backend, 0, 2, ADVANCED, DRAWS, "Program", "device that renders and trains; vulkan: in builds with make VULKAN=1; auto: a GPU if there is one"),
ROW("device", "best|N", INT, device, 0, 2147483647, ADVANCED, DRAWS, "Program", "index of the device in the list that info --devices prints, counted from 0"),
ROW("devices", NULL, FLAG, devices, 0, 1, ADVANCED, IN(INFO), "Program", "list the Vulkan devices instead; FILE is not needed"),
ROW("threads", "all|T", INT, threads, 0, 2147483647, BASIC, EVERYWHERE, "Program", "number of threads; the result does not depend on it"),
ROW("quiet", NULL, FLAG, quiet, 0, 1, BASIC, EVERYWHERE, "Program", "print only results, warnings and errors"),
ROW("verbose", NULL, FLAG, verbose, 0, 1, BASIC, EVERYWHERE, "Program", "also print the evidence of each decision, as in run.json and the report"),
ROW("help", "[all]", TEXT, help, 0, 0, BASIC, EVERYWHERE, "Program", "print this text; all: with advanced and expert options"),
};
/* clang-format on */
#undef LEAST
#undef MOST

struct arguments arguments_default(void)
{
    return (struct arguments){.split = OXL_SPLIT_TEST,
                              .threads = -1,
                              .device = -1,
                              .seeds = 1,
                              .frames = 120,
                              .min_views = 2,
                              .job = oxl_job_options_default(OXL_PRESET_DRAFT),
                              .synth = synth_options_default()};
}

/* ---------------- both tables as one */

int cli_option_count(void)
{
    return oxl_option_count() + CLI_COUNT(CLI_OPTIONS);
}

const oxl_option *cli_option_at(int index)
{
    const int ours = index - oxl_option_count();
    return ours < 0 ? oxl_option_at(index) : &CLI_OPTIONS[ours];
}

int cli_option_of_job(int index)
{
    return index < oxl_option_count() ? index : -1;
}

/* Returns the commands, a bit each, that take an option of the job with this use. */
static unsigned cli_commands_of(unsigned use)
{
    unsigned commands = 0;
    if (use & OXL_OPTION_OF_SURVEY)
        commands |= TRAINS | STUDIES | IN(RENDER) | IN(CLOUD) | IN(COMPARE) | IN(EVAL) | IN(MEASURE);
    if (use & OXL_OPTION_OF_TRAINING) commands |= TRAINS | STUDIES;
    if (use & OXL_OPTION_OF_RUN) commands |= TRAINS;
    if (use & OXL_OPTION_OF_OUT) commands |= IN(TRAIN) | STUDIES;
    if (use & OXL_OPTION_OF_BLOCK) commands |= IN(TRAIN);
    return commands;
}

/* Returns 1 for the options by which the rows of an ablation differ. */
int cli_is_study_variable(const char *name)
{
    static const char *const names[] = {"ucd", "keep", "dog", "cut"};
    for (int i = 0; i < CLI_COUNT(names); i++)
        if (strcmp(name, names[i]) == 0) return 1;
    return 0;
}

int cli_option_is_of(int index, enum command command)
{
    const oxl_option *o = cli_option_at(index);
    if (command == COMMAND_ABLATE && cli_option_of_job(index) >= 0 && cli_is_study_variable(o->name))
        return 0;
    return ((cli_option_of_job(index) < 0 ? o->use : cli_commands_of(o->use)) >> command & 1) != 0;
}

const char *cli_option_word(const oxl_option *o, char out[40])
{
    snprintf(out, 40, "%s%s", o->name[1] ? "--" : "-", o->name);
    return out;
}
