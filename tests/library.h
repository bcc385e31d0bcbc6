/* library.h - includes every internal header of the library, for tests, benches and fuzz targets. */
#ifndef TEST_LIBRARY_H
#define TEST_LIBRARY_H

#include "../src/core/core.h" /* first: it chooses POSIX before any system header */
#include "../oceanxl_job.h"
#include "../src/core/bytes.h"
#include "../src/core/codec.h"
#include "../src/core/eigen.h"
#include "../src/core/json.h"
#include "../src/core/os.h"
#include "../src/core/simd.h"
#include "../src/core/vecmath.h"
#include "../src/blocks/blocks.h"
#include "../src/blocks/partition.h"
#include "../src/blocks/partition_build.h"
#include "../src/job/job.h"
#include "../src/job/job_state.h"
#include "../src/model/model.h"
#include "../src/render/device.h"
#include "../src/render/kernels.h"
#include "../src/render/real.h"
#include "../src/render/render.h"
#include "../src/render/renderer_state.h"
#include "../src/survey/colmap.h"
#include "../src/survey/image.h"
#include "../src/survey/imaging.h"
#include "../src/survey/json_survey.h"
#include "../src/survey/lint.h"
#include "../src/survey/photometry.h"
#include "../src/survey/ply.h"
#include "../src/survey/scene.h"
#include "../src/survey/sparse.h"
#include "../src/survey/survey.h"
#include "../src/train/train.h"
#include "../src/train/train_parts.h"
#include "../src/train/train_state.h"

#endif
