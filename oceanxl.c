/* oceanxl.c - the whole library as one translation unit, and its table of contents in reading order.
 *
 *     cc -O3 -std=c99 -fopenmp -ffp-contract=off -fno-math-errno -fno-trapping-math \
 *         main.c cli/ *.c tools/ *.c oceanxl.c -lm    is a whole build
 */
#define OXL_UNITY
#include "src/core/core.h"  /* context, errors, memory, text, numbers, files */
#include "src/core/simd.h"  /* run-time selection of the instruction set */
#include "src/core/bytes.h" /* little-endian numbers in files */

#include "src/core/memory.c"     /* errors, memory */
#include "src/core/text.c"       /* growing text, paths */
#include "src/core/log.c"        /* log lines */
#include "src/core/os_posix.c"   /* the operating system: files, folders, clock, memory */
#include "src/core/os_windows.c" /* the same on Windows */
#include "src/core/os.c"         /* on top of them: atomic writes, reading, errors */
#include "src/core/checksum.c"   /* checksums of working files */
#include "src/core/context.c"    /* options, threads, interruption */
#include "src/core/number.c"     /* fast, exact, locale-independent number parsing */
#include "src/core/codec.h"
#include "src/core/codec.c"   /* JPEG, PNG and deflate, by stb */
#include "src/core/options.c" /* the table of options, parsing and printing */

/* the survey in memory */
#include "src/survey/camera.c"        /* camera models, undistortion */
#include "src/survey/image.c"         /* decode, undistort, reduce, mask */
#include "src/survey/image_header.c"  /* size, bits, EXIF orientation */
#include "src/survey/tracks.c"        /* walks over the observations of points */
#include "src/survey/track_samples.c" /* points in the images that observe them, sampled */
#include "src/survey/robust_stats.c"  /* robust statistics: bounds, radius of the cameras, depths */
#include "src/survey/image_file.c"    /* decoded images in files */
#include "src/survey/scene.c"         /* views, points, depths and rays of a scene */
#include "src/survey/scene_start.c"   /* points to start from where there are none */
#include "src/survey/scene_images.c"  /* its images and masks */
#include "src/survey/scene_make.c"    /* a scene from arrays; what is derived from views and points */
#include "src/survey/pose.c"          /* camera poses beside those of the files */
#include "src/survey/imaging.c"       /* imaging.txt: exposure gains and medium of a model */
#include "src/survey/contrast.c"      /* fall of image contrast with depth */
#include "src/survey/scene_fixed.c" /* finds the pixels that show the same in all images of a camera, wherever it is */
#include "src/survey/misfit.c"     /* measures how much of a render's error a displaced camera explains */
#include "src/survey/photometry.c" /* exposure, lamp and medium from the colours of tracks */

/* the model */
#include "src/model/model.c" /* planes of Gaussians: create, grow, initialise from points */

/* readers and writers of files */
#include "src/formats/colmap.h"        /* shared by the COLMAP readers */
#include "src/formats/colmap_fields.c" /* fields of COLMAP's files, text or binary */
#include "src/formats/colmap.c"        /* COLMAP models, and where an image saw its points */
#include "src/formats/json.c"          /* JSON reader */
#include "src/formats/json_survey.c"   /* surveys in JSON, converted to COLMAP rows */
#include "src/formats/ply.c"           /* PLY reader */
#include "src/formats/ply_points.c"    /* points of a PLY file */
#include "src/formats/nerfstudio.c"    /* transforms.json */
#include "src/formats/opensfm.c"       /* reconstruction.json */
#include "src/formats/llff.c"          /* poses_bounds.npy */
#include "src/formats/survey_find.c"   /* the formats of surveys, a row each; which sub-model */
#include "src/formats/survey_files.c"  /* paths of a survey's files */
#include "src/formats/ideal_camera.c"  /* the pinhole camera of undistorted images */
#include "src/formats/survey_alpha.c"  /* transparent pixels: composited or masked */
#include "src/formats/scene_views.c"   /* views of a survey */
#include "src/formats/scene_build.c"   /* a scene from the rows of files: origin, points, masks */
#include "src/formats/survey_load.c"   /* a scene from a survey's folder */
#include "src/formats/imaging_file.c"  /* imaging.txt beside a model */
#include "src/formats/model_text.c"    /* comments and values that the formats of models share */
#include "src/formats/spz.c"           /* models as SPZ */
#include "src/formats/splat_file.c"    /* models as .splat */
#include "src/formats/model_file.c"    /* models from PLY */
#include "src/formats/image_write.c"   /* writes PNG and JPEG, in memory by codec */
#include "src/formats/json_file.c" /* reads a survey in JSON, by the reader that knows the name of its file */
#include "src/formats/scene_twins.c"   /* finds images that are copies of others */
#include "src/formats/model_formats.c" /* the formats of models, a row each */

/* forward and backward pass of one image */
#include "src/render/real.h"    /* the number type of the kernels and its arithmetic */
#include "src/render/kernels.h" /* types of the kernels */
#include "src/render/medium.h"  /* attenuation and backscatter between camera and Gaussians, inlined into: */
#include "src/render/project.c" /* Gaussians to splats: forward and backward */
#include "src/render/bin.c"     /* splats per tile, in depth order */
#include "src/render/raster.c"  /* splats to pixels: forward and backward */
#include "src/render/loss.c"    /* L1 + SSIM: value and gradient */
#include "src/render/medium.c"  /* medium baked into colours; veiling light behind the last Gaussian */
#include "src/render/depth_loss.c"     /* opacity in front of points of known depth */
#include "src/render/exposure.c"       /* gains between the rendered image and the loss */
#include "src/render/adam.c"           /* optimizer step */
#include "src/render/kernel_camera.c"  /* the camera of the kernels */
#include "src/render/device.h"         /* the functions of a device */
#include "src/render/renderer_state.h" /* the renderer's state */
#include "src/render/renderer.c"       /* chains the kernels above: the forward pass */
#include "src/render/renderer_loss.c"  /* exposure, lamp, loss, backward pass */
#include "src/render/renderer_step.c"  /* optimizer step, statistics */
#include "src/render/render_model.c"   /* the public functions */
#ifdef OXL_VULKAN
#include "backends/vulkan/frames.c"   /* command buffers, copies */
#include "backends/vulkan/passes.c"   /* compute shaders */
#include "backends/vulkan/memory.c"   /* buffers and memory limits */
#include "backends/vulkan/instance.c" /* loader, instance; only in builds with make VULKAN=1 */
#include "backends/vulkan/device.c"   /* choice of a device */
#include "backends/vulkan/images.c"   /* training images that stay on the device */
#include "backends/vulkan/resident.c" /* what else stays on the device between steps */
#include "backends/vulkan/imaging.c"  /* medium, lamp, dropout, depth loss */
#include "backends/vulkan/forward.c"  /* the forward pass as passes */
#include "backends/vulkan/renderer.c" /* functions of the renderer as passes */
#endif
#include "src/render/backend.c" /* selects the CPU or Vulkan */

/* images compared */
#include "src/evaluate/planes.c"    /* planes, blurred by a Gaussian window */
#include "src/evaluate/metrics.c"   /* two images compared: PSNR, SSIM */
#include "src/evaluate/unshown.c"   /* pixels whose place no training view shows */
#include "src/evaluate/structure.c" /* the same whatever their contrast: correlation of their detail */
#include "src/evaluate/align.c"     /* a camera moved onto its image */
#include "src/evaluate/evaluate.c"  /* a model's images against those of a survey */

/* training */
#include "src/train/part.h"            /* the hooks of a part of training */
#include "src/train/archive.c"         /* the state of a run as bytes */
#include "src/train/density.c"         /* which Gaussians are split or removed, opacity reset */
#include "src/train/scalar_adam.c"     /* Adam for single numbers, of medium and lamp */
#include "src/train/nonfinite.c"       /* handles and counts values that are not finite */
#include "src/train/schedule.c"        /* values that depend on options and step only */
#include "src/train/parts.c"           /* calls the hooks of all parts */
#include "src/train/forecast.c"        /* how many Gaussians and how much time a run will take */
#include "src/train/step.c"            /* one step: forward, loss, backward, Adam; density control */
#include "src/train/model_selection.c" /* validation views and trials */
#include "src/train/train_imaging.c"   /* light and water of a run, before and after its steps */
#include "src/train/trained.c"         /* trains a scene and returns all that comes of it */
#include "src/train/unseen.c"          /* removes the Gaussians that no training view shows */
#include "src/train/train_loop.c"      /* the training loop: one step with the decisions after it */

/* the parts of training: a file and a row of the table each */
#include "src/parts/ucd.c"           /* depth weights of density control */
#include "src/parts/dropout.c"       /* leaves out Gaussians at random */
#include "src/parts/lobes.c"         /* which Gaussians get a second lobe */
#include "src/parts/prune.c"         /* pruning: schedule and scores */
#include "src/parts/exposure.c"      /* log gains per training image */
#include "src/parts/medium.c"        /* the nine parameters of the medium */
#include "src/parts/lamp.c"          /* a light that moves with the camera */
#include "src/parts/track_depth.c"   /* depths that the tracks give */
#include "src/parts/ssim_contrast.c" /* the contrast of the images, for SSIM in the loss */
#include "src/parts/antialias.c"     /* splats that keep their light at every size */
#include "src/parts/stereo.c"        /* points to start from, by stereo */
#include "src/parts/sh_degree.c"     /* degree of the spherical harmonics */
#include "src/parts/poses.c"         /* the pose of each training view's camera, refined with the scene */
#include "src/parts/table.c"         /* the table */

/* checks of a survey */
#include "src/checks/quality.c" /* images unlike those taken beside them */
#include "src/checks/lint.c"    /* checks poses, images and masks against the points */
#include "src/checks/hypotheses.c" /* tells whether images, poses and points belong together, and if not, how they would */

/* surveys larger than memory: memory and time predicted, blocks */
#include "src/large/partition.h"      /* shared by these files */
#include "src/large/partition_axes.c" /* principal axes, the frame of the partition */
#include "src/large/partition_cut.c"  /* where a box is cut */
#include "src/large/partition_make.c" /* how many blocks, and the plan of them */
#include "src/large/merge.c"          /* merge the models of blocks */
#include "src/large/cost.c"           /* predicted Gaussians, memory and time of training */
#include "src/large/budget.c"         /* --ram: limits that fit a memory budget */
#include "src/large/os_job_posix.c"   /* the operating system: locks, peak memory */
#include "src/large/os_job_windows.c" /* the same on Windows */
#include "src/large/os_job.c"         /* on top of them: links refused, locks */
#include "src/large/lock.c"           /* one process at a time writes to a folder */
#include "src/large/checkpoint.c"     /* a run's state in a file, for resuming */
#include "src/large/block.c"          /* training of one block in its folder */
#include "src/large/job_state.h"      /* shared by the files of a job */
#include "src/large/job_state.c"      /* names in OUT, the survey, progress, the blocks' models */
#include "src/large/block_plan.c"     /* windows, steps and budget of each block */
#include "src/large/blocks.c"         /* several blocks trained as one model */

/* the whole job */
#include "src/job/survey_report.c"   /* content of a survey and predicted cost of training */
#include "src/job/survey_checksum.c" /* whether the files are those of an earlier run */
#include "src/job/manifest.c"        /* run.json: all inputs of a result */
#include "src/job/out_folder.c"      /* folders that a run may not write to */
#include "src/job/overlap.c"         /* does a model belong to a survey? */
#include "src/job/render_files.c"    /* renders as files */
#include "src/job/training_views.c"  /* training views with much larger error than their neighbours */
#include "src/job/metrics_json.c"    /* metrics as JSON */
#include "src/job/job_result.c"      /* the model in its files, metrics.json, run.json, renders */
#include "src/job/job_run.c"         /* the whole job: survey folder in, output folder out */
