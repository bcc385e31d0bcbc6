/* oceanxl.c - the front door: the whole library as one translation unit. This is also its table of contents, in reading order.
 *
 *     cc -O3 -fopenmp main.c cli/ *.c lab/ *.c oceanxl.c -lm    is a whole build
 */
#include "src/core/core.h" /* context, errors, memory, text, numbers, files; each layer has one such header */
#include "src/core/simd.h" /* run-time choice of the instruction set */

#include "src/core/os.c"      /* what C99 lacks: files that appear whole or not at all, clock, memory use */
#include "src/core/context.c" /* context, errors, memory, text, random numbers */
#include "src/core/number.c"  /* fast, exact, locale-independent number parsing */

/* the survey comes in */
#include "src/core/json.c"            /* a cursor over JSON */
#include "src/core/ply.c"             /* a small PLY reader */
#include "src/survey/colmap.h"        /* what the readers of COLMAP's text files share */
#include "src/survey/colmap_text.c"   /* lines and fields through a window on a file, and what is said of wrong ones */
#include "src/survey/colmap_binary.c" /* its binary files */
#include "src/survey/colmap_order.c"  /* rows by id */
#include "src/survey/colmap_points.c" /* points3D.txt, by several threads */
#include "src/survey/colmap.c"        /* cameras.txt, images.txt, and the three together */
#include "src/survey/colmap_write.c"  /* the three, written */
#include "src/survey/json_survey.c"   /* surveys in JSON, as the same rows */
#include "src/survey/nerfstudio.c"    /* transforms.json */
#include "src/survey/opensfm.c"       /* reconstruction.json */
#include "src/survey/camera.c"        /* camera models, undistortion */
#include "src/survey/image.c"         /* photographs: decode, reduce, undistort, mask */
#include "src/survey/survey_files.c"  /* where a survey's files are */
#include "src/survey/robust_stats.c"  /* robust measures: bounds, the cameras' radius, depths */
#include "src/survey/image_cache.c"   /* which photographs are in memory */
#include "src/survey/scene.c"         /* from the files to views, points and photographs */
#include "src/survey/imaging.c"       /* a gain per view between the scene's colours and an image */
#include "src/survey/depth_bands.c"   /* near, mid or far: what each pixel shows, as the points tell */

/* a survey too large for one model becomes blocks */
#include "src/blocks/partition.h"            /* what these files share */
#include "src/blocks/partition_axes.c"       /* the frame in which it is cut */
#include "src/blocks/partition_visibility.c" /* who saw which point */
#include "src/blocks/partition.c"            /* the cuts, the guards, which view belongs where */
#include "src/blocks/partition_file.c"       /* partition.txt */
#include "src/blocks/partition_svg.c"        /* partition.svg */
#include "src/blocks/partition_export.c"     /* blocks as COLMAP text exports */

/* the model */
#include "src/model/model.c"      /* planes of Gaussians: create, grow, start from points */
#include "src/blocks/merge.c"     /* the models of blocks become one */
#include "src/model/spz.c"        /* models as SPZ */
#include "src/model/gltf.c"       /* models as binary glTF */
#include "src/model/model_file.c" /* models as PLY and .splat */

/* one photograph's error walks back into the Gaussians */
#include "src/render/kernels.h"  /* the types that the kernels speak in */
#include "src/render/project.c"  /* Gaussians onto the image plane, and back */
#include "src/render/bin.c"      /* which tile sees which splat, in depth order */
#include "src/render/raster.c"   /* splats to pixels, and back */
#include "src/render/loss.c"     /* L1 + SSIM, and back */
#include "src/render/medium.c"   /* water between the camera and the Gaussians */
#include "src/render/exposure.c" /* a gain per channel between the rendered image and the loss */
#include "src/render/adam.c"     /* the step that follows the gradient */
#include "src/render/renderer.c" /* the chain of the five above behind one door */
#ifdef OXL_VULKAN
#include "backends/vulkan/device.c"   /* loader, instance, device; in no build but make VULKAN=1 */
#include "backends/vulkan/memory.c"   /* buffers, and how much memory there is for them */
#include "backends/vulkan/passes.c"   /* commands, compute shaders */
#include "backends/vulkan/resident.c" /* what stays on the device between steps */
#include "backends/vulkan/renderer.c" /* the renderer's functions as passes */
#endif
#include "src/render/backend.c" /* which of the two draws */

/* the run */
#include "src/train/checkpoint.c"      /* the state of a run in a file, so that a run that was killed goes on where it was */
#include "src/train/density.c"         /* clone, split, prune, reset */
#include "src/train/spsa.c"            /* the search for the depth weights, without a gradient */
#include "src/survey/contrast.c"       /* how fast contrast fades with depth: the water, measured */
#include "src/train/ucd.c"             /* weights by depth for density control, and their search */
#include "src/train/prune.c"           /* fewer Gaussians: when, and which matter least */
#include "src/train/transients.c"      /* what swims through one photograph is not learned */
#include "src/train/water.c"           /* the nine parameters of the medium */
#include "src/train/lamp.c"            /* a light that moves with the camera */
#include "src/train/exposure.c"        /* log gains per training image */
#include "src/train/nonfinite.c"       /* numbers that are not finite: put aside, counted, told */
#include "src/train/schedule.c"        /* what depends on the options and the step alone */
#include "src/train/step.c"            /* the parts of one step: forward, loss, backward, Adam, density, pruning */
#include "src/train/branch.c"          /* copies of the training state */
#include "src/train/model_selection.c" /* model only what the scene requires: SH degree, second lobes */
#include "src/train/train.c"           /* the loop: it reads like the paper's algorithm */
#include "src/job/metrics.c"           /* PSNR, SSIM, MS-SSIM, evaluation */
#include "src/job/seam.c"              /* do the borders between blocks show? */

/* the whole job */
#include "src/job/predict_time.c"      /* some steps before the run, to see how long its steps will take */
#include "src/survey/lint.c"           /* poses that are not those of the points, photographs that cannot be used */
#include "src/job/survey_report.c"     /* what a survey holds, and what training it would take */
#include "src/job/partition_balance.c" /* how even the blocks are, and what each will take */
#include "src/job/budget.c"            /* --ram: what fits into how much memory */
#include "src/job/options.c"           /* the options of a job: one table, and what is made from it */
#include "src/job/manifest.c"          /* run.json: what a result depends on */
#include "src/job/block.c"             /* the training of one block in its folder */
#include "src/job/render_files.c"      /* what the model draws, as files */
#include "src/job/training_views.c"    /* which training views fit far worse than their neighbours */
#include "src/job/job.c"               /* a survey in, a folder with the model, its metrics and pictures out */
