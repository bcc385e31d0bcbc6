/* state.h - an open Vulkan device, its buffers and passes: what the files of this folder share. Each calls
 * only those before it:
 *
 *     frames.c    errors, command buffers, copies
 *     passes.c    passes
 *     memory.c    buffers
 *     instance.c  loader, instance
 *     device.c    choice of a device
 *     images.c    training images that stay on the device
 *     resident.c  what else a renderer keeps there
 *     imaging.c   medium, lamp, dropout, the loss in front of points
 *     forward.c   the forward pass
 *     renderer.c  loss, backward pass, step; the table of struct renderer_device
 *
 * Passes are recorded one after the other into one command buffer, each with a barrier behind it, and
 * submitted when the host needs a result, or at the end of a frame: two frames take turns, so that one is
 * recorded while the device works on the other. The first error while recording stays in vulkan.rc: further
 * records do nothing, and vulkan_finish returns it.
 */
#ifndef OXL_VULKAN_STATE_H
#define OXL_VULKAN_STATE_H

#include "vulkan.h"

#define VK_NO_PROTOTYPES
#include <vulkan/vulkan.h>

#include "generated/bindings.h"

#define VULKAN_GROUP 256u           /* invocations a workgroup, as in shaders/common.glsl */
#define VULKAN_CHUNK 2048u          /* numbers that a workgroup scans or sorts */
#define VULKAN_BUCKET 128u          /* pairs of a bucket, as in shaders/raster.glsl */
#define VULKAN_SLAB_ROWS (1u << 20) /* rows of a slab, at most: 264 MB of all planes */
/* bytes of the buffer between host and device, of a frame */
#define VULKAN_STAGING (16u << 20)
#define VULKAN_MARKS (VULKAN_FRAMES * VULKAN_STAGING) /* behind it: a word of each frame, see vulkan_mark */
#define VULKAN_SETS 1024                              /* passes of a frame, at most */
#define VULKAN_BINDINGS 16                            /* of a pass, at most */
/* numbers that one workgroup scans on its own: fewer passes, though longer ones */
#define VULKAN_SCAN_WHOLE (16u << 10)
/* ns, times the submissions of a frame: a GPU that takes longer is given up */
#define VULKAN_WAIT 60000000000ull
/* deferred steps have room for a share of pairs more than the first one has, its inverse */
#define VULKAN_ROOM 2
/* (tile, splat) pairs that a device other than a discrete GPU draws in one submission */
#define VULKAN_PART (1u << 18)
enum {
    VULKAN_VARIANTS = 8,
    VULKAN_DIGIT = 8, /* bits of a digit, of the sort */
    VULKAN_DIGITS = 256,
    VULKAN_FRAMES = 2,     /* one is recorded while the other is worked on */
    VULKAN_COMMANDS = 160, /* submissions of a frame, at most */
    VULKAN_READS = 128,    /* pieces that the host waits for at a time */
    VULKAN_IMAGE_SHARE = 4 /* of the device's memory, its inverse: images are kept there up to so much */
};

/* ---------------- functions of the loader, by name */

/* clang-format off */ /* it would make a staircase of these */
#define VULKAN_OF_LOADER(X) X(CreateInstance) X(EnumerateInstanceLayerProperties) X(EnumerateInstanceExtensionProperties)
#define VULKAN_OF_INSTANCE(X) \
    X(DestroyInstance) X(EnumeratePhysicalDevices) X(GetPhysicalDeviceProperties) X(GetPhysicalDeviceMemoryProperties) \
    X(GetPhysicalDeviceQueueFamilyProperties) X(EnumerateDeviceExtensionProperties) X(CreateDevice) X(GetDeviceProcAddr) \
    X(GetPhysicalDeviceMemoryProperties2KHR) /* NULL where the instance has no such extension */
#define VULKAN_OF_DEVICE(X) \
    X(DestroyDevice) X(GetDeviceQueue) X(CreateBuffer) X(DestroyBuffer) X(GetBufferMemoryRequirements) \
    X(AllocateMemory) X(FreeMemory) X(BindBufferMemory) X(MapMemory) X(CreateShaderModule) X(DestroyShaderModule) \
    X(CreateDescriptorSetLayout) X(DestroyDescriptorSetLayout) X(CreatePipelineLayout) X(DestroyPipelineLayout) \
    X(CreateComputePipelines) X(DestroyPipeline) X(CreateDescriptorPool) X(DestroyDescriptorPool) X(ResetDescriptorPool) \
    X(AllocateDescriptorSets) X(UpdateDescriptorSets) X(CreateCommandPool) X(DestroyCommandPool) X(AllocateCommandBuffers) \
    X(ResetCommandPool) X(BeginCommandBuffer) X(EndCommandBuffer) X(CmdBindPipeline) X(CmdBindDescriptorSets) \
    X(CmdPushConstants) X(CmdDispatch) X(CmdPipelineBarrier) X(CmdCopyBuffer) X(CmdUpdateBuffer) X(CmdFillBuffer) \
    X(CmdResetQueryPool) X(CmdWriteTimestamp) X(CreateQueryPool) X(DestroyQueryPool) X(GetQueryPoolResults) X(QueueSubmit) \
    X(CreateFence) X(DestroyFence) X(WaitForFences) X(ResetFences)
/* clang-format on */
#define VULKAN_DECLARE(name) PFN_vk##name name;

/* ---------------- the passes: one shader each */

enum vulkan_pass {
    PASS_PROJECT,
    PASS_SCAN,
    PASS_COMPACT,
    PASS_SORT_COUNT,
    PASS_SORT_SCATTER,
    PASS_FOOTPRINT,
    PASS_RANGES,
    PASS_RASTER,
    PASS_RASTER_LOBED,
    PASS_RASTER_BACKWARD,
    PASS_RASTER_BACKWARD_LOBED,
    PASS_LOSS_FORWARD,
    PASS_LOSS_TOTAL,
    PASS_LOSS_BACKWARD,
    PASS_PROJECT_BACKWARD,
    PASS_STEP,
    PASS_OBSERVE,
    PASS_SCORE,
    PASS_UNPACK,
    PASS_MOVE,
    PASS_LAMP,
    PASS_IMAGING_PIXELS,
    PASS_IMAGING_TOTAL,
    PASS_DEPTH_LOSS,
    PASS_PEAK, /* of the benchmark alone */
    PASS_COUNT
};

struct vulkan_pipeline {
    VkDescriptorSetLayout set;
    VkPipelineLayout layout;
    VkPipeline variant[VULKAN_VARIANTS]; /* made when first run */
};

struct vulkan_buffer {
    VkBuffer handle;
    VkDeviceMemory memory;
    VkDeviceSize size;
    size_t counted; /* bytes, in vulkan.allocated */
};

struct vulkan_read { /* something that the host waits for */
    void *to;
    size_t at, size; /* in the staging buffer */
};

/* What is recorded and submitted together, and the memory that it needs until the device is done. */
struct vulkan_frame {
    VkCommandPool command_pool;
    VkCommandBuffer command[VULKAN_COMMANDS];
    VkDescriptorPool descriptor_pool;
    VkFence fence;
    int command_at; /* submissions so far without a fence */
    int under_way;  /* submitted with the fence, and not waited for */
    int sets;
    uint32_t mark;                /* of the last submission with the fence: vulkan_mark */
    size_t staged;                /* bytes of its part of the staging buffer in use */
    uint8_t pass_at[VULKAN_SETS]; /* of the sets in use: which pass */
};

struct vulkan_renderer;

struct vulkan {
    oxl_context *ctx;
    struct vulkan_renderer *renderers; /* a list of all that are there */
    /* Frees device memory whose contents can be uploaded again (cached images) and returns how many buffers
     * that were; NULL: there are none. but: a frame (vulkan_frame_number) that is still recorded, while all
     * others have ended: its buffers are kept. 0: waits for all frames first. */
    size_t (*evict)(struct vulkan *v, uint32_t but);
    void *library;
    VULKAN_OF_LOADER(VULKAN_DECLARE)
    VULKAN_OF_INSTANCE(VULKAN_DECLARE)
    VULKAN_OF_DEVICE(VULKAN_DECLARE)
    PFN_vkGetInstanceProcAddr GetInstanceProcAddr;
    VkInstance instance;
    VkDebugUtilsMessengerEXT messenger;
    /* VK_KHR_get_physical_device_properties2 is on: portability and budgets depend on it */
    int properties2;
    int validates, validation_messages; /* whether the validation layer is on; its messages so far */
    /* from here on of the device: vulkan_close_device clears it */
    VkPhysicalDevice physical;
    int budgets; /* VK_EXT_memory_budget is on */
    /* a part of Vulkan alone, as by MoltenVK: Metal grants memory beyond its budget, and fails when it is
     * used */
    int portable;
    VkPhysicalDeviceProperties properties;
    char name_and_cpu[VK_MAX_PHYSICAL_DEVICE_NAME_SIZE + 8];
    VkPhysicalDeviceMemoryProperties memory;
    VkDevice device;
    VkQueue queue;
    uint32_t family; /* of the queue */
    int said_beyond; /* that an allocation exceeds the memory left */
    uint32_t kind;   /* of the memory of buffers that the host does not see */
    struct vulkan_frame frame[VULKAN_FRAMES];
    int at;                   /* the frame that is recorded */
    VkCommandBuffer commands; /* and its command buffer */
    struct vulkan_pipeline pipeline[PASS_COUNT];
    struct vulkan_buffer staging, dummy; /* dummy: for bindings that a pass does not use */
    char *mapped;                        /* staging, as the host sees it */
    size_t sent, read_bytes;             /* by vulkan_upload; by vulkan_queue_read: so far */
    size_t waits;                        /* of the host, with nothing left for the device to do: so far */
    size_t frame_waits;                  /* for the frame before, while the device has the next one */
    size_t dispatches, barriers, submissions;
    struct vulkan_read read[VULKAN_READS];
    int reads;
    int recording, updates; /* updates: commands without a barrier behind them */
    /* what is recorded holds something that the host takes for done: a step, an upload */
    int relied_on;
    uint32_t mark;       /* of the last frame submitted */
    int marked;          /* it is that of the frame that is recorded */
    VkResult lost;       /* by what, permanently: no call to the device is allowed, not even to wait */
    VkQueryPool clock;   /* (VULKAN_FRAMES, VULKAN_SETS, 2) see vulkan_measure */
    uint64_t stamp_mask; /* of the bits of a time that count */
    double pass_seconds[PASS_COUNT];
    int pass_runs[PASS_COUNT];
    oxl_result rc;
    /* the failure `rc`, even with smaller buffers: what was recorded is lost, or a shader is refused */
    int is_permanent;
    uint64_t timeout_ns;              /* of a wait, for each submission */
    size_t range;                     /* bytes: the largest array */
    size_t allocated, most_allocated; /* bytes of buffers that the host does not see; at most so far */
    size_t image_bytes_max;           /* bytes of images that a renderer may keep */
    uint32_t slab_rows;               /* at most */
    uint32_t groups_max;              /* in one dimension of a dispatch */
    size_t part; /* (tile, splat) pairs that a submission draws, about: vulkan_in_parts; 0: any */
};

/* ---------------- frames.c */

OXL_INTERNAL const char *vulkan_word(VkResult result);
OXL_INTERNAL int vulkan_is_short(VkResult result); /* of memory */
/* keeps the first failure; 1: none so far */
OXL_INTERNAL int vulkan_ok(struct vulkan *v, VkResult result, const char *what);
/* The same of a call that makes `handle`: where it fails, Vulkan leaves anything there. */
OXL_INTERNAL int vulkan_made(struct vulkan *v, VkResult result, void *handle, size_t size, const char *what);
#define VULKAN_MADE(v, result, handle, what) vulkan_made(v, result, &(handle), sizeof(handle), what)
/* 1: a smaller buffer may do, and the failure is forgotten */
OXL_INTERNAL int vulkan_may_retry(struct vulkan *v);

OXL_INTERNAL int vulkan_give_up(struct vulkan *v, VkResult result); /* no call to the device from now on; 0 */
OXL_INTERNAL int vulkan_record(struct vulkan *v);                   /* 1: commands may be recorded */
OXL_INTERNAL void vulkan_barrier(struct vulkan *v);
/* submits what was recorded and waits for all frames */
OXL_INTERNAL oxl_result vulkan_finish(struct vulkan *v);
/* Submits the frame and goes on with the other, as soon as the device is done with it. */
OXL_INTERNAL oxl_result vulkan_next_frame(struct vulkan *v);
OXL_INTERNAL uint32_t vulkan_frame_number(const struct vulkan *v);
OXL_INTERNAL void vulkan_flush(struct vulkan *v); /* submits what was recorded, without waiting */
/* first in every interface function: clears an earlier error */
OXL_INTERNAL void vulkan_enter(struct vulkan *v);
OXL_INTERNAL oxl_result vulkan_measure(struct vulkan *v);
OXL_INTERNAL struct vulkan_frame *vulkan_frame(struct vulkan *v); /* the one that is recorded */
OXL_INTERNAL int vulkan_ready(struct vulkan *v); /* 1: any command may be recorded, behind those that were */
/* Takes the time before (0) or after (1) the pass that is recorded next. What went before has ended: the
 * barrier behind it sees to that. */
OXL_INTERNAL void vulkan_stamp(struct vulkan *v, enum vulkan_pass pass, uint32_t after);

OXL_INTERNAL void vulkan_upload(struct vulkan *v, const struct vulkan_buffer *to, size_t offset,
                                const void *from, size_t size);
/* From the beginning of a buffer to `offset` of another. */
OXL_INTERNAL void vulkan_copy(struct vulkan *v, const struct vulkan_buffer *from,
                              const struct vulkan_buffer *to, size_t offset, size_t size);
/* vulkan_queue_read records a copy into `to`, which vulkan_collect fills: many small pieces, one wait.
 * Nothing may be submitted in between. */
OXL_INTERNAL void vulkan_queue_read(struct vulkan *v, const struct vulkan_buffer *from, size_t offset,
                                    void *to, size_t size);
OXL_INTERNAL void vulkan_collect(struct vulkan *v);
OXL_INTERNAL void vulkan_download(struct vulkan *v, const struct vulkan_buffer *from, size_t offset, void *to,
                                  size_t size);
OXL_INTERNAL void vulkan_update(struct vulkan *v, const struct vulkan_buffer *to, size_t offset,
                                const void *from, size_t size);
OXL_INTERNAL void vulkan_fill(struct vulkan *v, const struct vulkan_buffer *to, size_t offset, size_t size,
                              uint32_t value);

/* ---------------- passes.c */

OXL_INTERNAL size_t vulkan_shared(void); /* bytes of shared memory that the passes need */
/* compiles it, once */
OXL_INTERNAL void vulkan_prepare(struct vulkan *v, enum vulkan_pass pass, uint32_t variant);
OXL_INTERNAL void vulkan_run(struct vulkan *v, enum vulkan_pass pass, uint32_t variant, size_t groups,
                             const void *push, const struct vulkan_buffer *const *buffer);

/* ---------------- memory.c */

OXL_INTERNAL void vulkan_create(struct vulkan *v, struct vulkan_buffer *b, size_t size, int for_host);
OXL_INTERNAL void vulkan_release(struct vulkan *v, struct vulkan_buffer *b);
/* vulkan_reserve_exactly: for what does not grow. At least so many elements; the contents are lost when it
 * grows. what: names them in an error. */
OXL_INTERNAL void vulkan_reserve(struct vulkan *v, struct vulkan_buffer *b, size_t count, size_t element,
                                 const char *what);
OXL_INTERNAL void vulkan_reserve_exactly(struct vulkan *v, struct vulkan_buffer *b, size_t count,
                                         size_t element, const char *what);

/* kind: of memory, by number */
OXL_INTERNAL size_t vulkan_memory_left(const struct vulkan *v, uint32_t kind);

/* ---------------- instance.c */

enum { VULKAN_EXTENSIONS = 4, VULKAN_LISTED = 512 };

/* Extensions that are there and wanted. */
struct vulkan_extensions {
    VkExtensionProperties *there; /* (count) */
    uint32_t count, enabled;
    const char *name[VULKAN_EXTENSIONS];
};
/* Asks for an extension; 1: it is there. */
OXL_INTERNAL int vulkan_enable(struct vulkan_extensions *e, const char *name);
OXL_INTERNAL oxl_result vulkan_start(struct vulkan *v);
OXL_INTERNAL void vulkan_stop_listening(struct vulkan *v); /* the messenger points to v */
OXL_INTERNAL void vulkan_stop(struct vulkan *v);

#define VULKAN_BUFFERS(...) ((const struct vulkan_buffer *const[]){__VA_ARGS__})
#define VULKAN_PUSH(...) ((const uint32_t[]){__VA_ARGS__})

/* Records pass PASS_name. It does not compile where what is pushed or bound is not as long as the shader has
 * it. */
#define VULKAN_SAME(a, b) ((void)sizeof(char[(a) == (b) ? 1 : -1]))
#define VULKAN_RUN(v, name, variant, groups, push, buffers)                      \
    (VULKAN_SAME(sizeof(push), SPIRV_##name##_PUSH),                             \
     VULKAN_SAME(sizeof(buffers) / sizeof(buffers)[0], SPIRV_##name##_BINDINGS), \
     vulkan_run(v, PASS_##name, variant, groups, push, buffers))

static inline size_t vulkan_groups(size_t items)
{
    return (items + VULKAN_GROUP - 1) / VULKAN_GROUP;
}

static inline size_t vulkan_chunks(size_t items)
{
    return (items + VULKAN_CHUNK - 1) / VULKAN_CHUNK;
}

static inline uint32_t vulkan_bits(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

#endif
