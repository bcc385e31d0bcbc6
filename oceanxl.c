/* oceanxl.c - the front door: the whole library as one translation unit. This is also its table of contents, in reading order.
 *
 *     cc -O3 -fopenmp main.c tools/ *.c oceanxl.c -lm        is a whole build
 */
#include "src/internal.h" /* what the modules share: errors, memory, one section for each module's door */
#include "src/simd.h"     /* run-time choice of the instruction set */

#include "src/os.c"     /* what C99 lacks: files that appear whole or not at all, clock, memory use */
#include "src/base.c"   /* context, errors, memory, text, random numbers */
#include "src/number.c" /* fast, exact, locale-independent number parsing */

/* the survey comes in */
#include "src/colmap.h"        /* what the readers of COLMAP's text files share */
#include "src/colmap_text.c"   /* lines and fields through a window on a file, and what is said of wrong ones */
#include "src/colmap_points.c" /* points3D.txt, by several threads */
#include "src/colmap.c"        /* cameras.txt, images.txt, and the three together */
#include "src/colmap_write.c"  /* the three, written */
#include "src/camera.c"        /* camera models, undistortion */
#include "src/image.c"         /* photographs: decode, reduce, undistort, mask */
#include "src/find.c"          /* where a survey's files are */
#include "src/measure.c"       /* robust measures: bounds, the cameras' radius, depths */
#include "src/photos.c"        /* which photographs are in memory */
#include "src/scene.c"         /* from the files to views, points and photographs */
#include "src/bands.c"         /* near, mid or far: what each pixel shows, as the points tell */

/* a survey too large for one model becomes blocks */
#include "src/partition.h"        /* what these files share */
#include "src/partition_axes.c"   /* the frame in which it is cut */
#include "src/partition_sight.c"  /* who saw which point */
#include "src/partition.c"        /* the cuts, the guards, which view belongs where */
#include "src/partition_file.c"   /* partition.txt */
#include "src/partition_svg.c"    /* partition.svg */
#include "src/partition_export.c" /* blocks as COLMAP text exports */

/* the model */
#include "src/ply.c"       /* a small PLY reader */
#include "src/model.c"     /* planes of Gaussians: create, grow, start from points */
#include "src/merge.c"     /* the models of blocks become one */
#include "src/modelfile.c" /* models as PLY and .splat */

/* one photograph's error walks back into the Gaussians */
#include "src/kernels.h" /* the types that the kernels speak in */
#include "src/project.c" /* Gaussians onto the image plane, and back */
#include "src/bin.c"     /* which tile sees which splat, in depth order */
#include "src/raster.c"  /* splats to pixels, and back */
#include "src/loss.c"    /* L1 + SSIM, and back */
#include "src/adam.c"    /* the step that follows the gradient */
#include "src/render.c"  /* the chain of the five above behind one door */
#ifdef OXL_VULKAN
#include "src/vulkan.c" /* the same on a Vulkan device; in no build but make VULKAN=1 */
#endif
#include "src/backend.c" /* which of the two draws */

/* the run */
#include "src/checkpoint.c" /* the state of a run in a file, so that a run that was killed goes on where it was */
#include "src/density.c"    /* clone, split, prune, reset */
#include "src/spsa.c"       /* the search for the depth weights, without a gradient */
#include "src/contrast.c"   /* how fast contrast fades with depth: the water, measured */
#include "src/ucd.c"        /* weights by depth for density control, and their search */
#include "src/prune.c"      /* fewer Gaussians: when, and which matter least */
#include "src/robust.c"     /* what swims through one photograph is not learned */
#include "src/faults.c"     /* numbers that are not finite: put aside, counted, told */
#include "src/decide.c"     /* model only what the scene requires: SH bands, second lobes */
#include "src/train.c"      /* the loop: it reads like the paper's algorithm */
#include "src/metrics.c"    /* PSNR, SSIM, MS-SSIM, evaluation */
#include "src/seam.c"       /* do the borders between blocks show? */

/* the whole job */
#include "src/rehearse.c"          /* some steps before the run, to see how long its steps will take */
#include "src/lint.c"              /* poses that are not those of the points, photographs that cannot be used */
#include "src/survey.c"            /* what a survey holds, and what training it would take */
#include "src/partition_balance.c" /* how even the blocks are, and what each will take */
#include "src/budget.c"            /* --ram: what fits into how much memory */
#include "src/run.c"               /* run.json: what a result depends on */
#include "src/block.c"             /* the training of one block in its folder */
#include "src/pictures.c"          /* what the model draws, as files */
#include "src/job.c"               /* a survey in, a folder with the model, its metrics and pictures out */
