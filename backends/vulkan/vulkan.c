/* vulkan.c - the renderer on a Vulkan device: the doors of renderer.c, each as a few passes of the shaders in shaders/.
 *
 * Only in builds with make VULKAN=1. The loader is opened at run time; the headers are wanted by the compiler alone.
 *
 * A step (compare renderer.c; the arrows are where the host waits):
 *     project, order by depth, count the pairs  ->  lay the pairs out, order by tile, draw, compare  ->  walk back, step, observe  ->
 * Passes are recorded one after the other, each with a barrier behind it, and sent when the host needs a result. What goes wrong while
 * recording is kept in vulkan.rc; further records do nothing, and vulkan_finish tells.
 *
 * The model lies in slabs of rows, each a buffer of its own: so no array that a shader sees exceeds maxStorageBufferRange, however many
 * Gaussians there are. What is indexed by any row has at most 16 bytes a row or pair.
 *
 * Invariants: no atomics on floats, and every sum has a written order, so a device repeats its own results. It does not give the
 * CPU's bytes: order of sums and rounding of single operations differ (tests/test_vulkan.c has the bounds).
 */
#include "vulkan.h"
#include "../../src/render/kernels.h"
#include "../../src/core/vecmath.h"

#define VK_NO_PROTOTYPES
#include <vulkan/vulkan.h>

#include "generated/spirv.h"

#include <stddef.h>

#define VULKAN_GROUP      256u           /* invocations a workgroup, as in shaders/common.glsl */
#define VULKAN_BLOCK      2048u          /* numbers that a workgroup scans or sorts */
#define VULKAN_SLAB_ROWS  (1u << 18)     /* rows of a slab, at most: 66 MB of all planes */
#define VULKAN_STAGING    (16u << 20)    /* bytes of the buffer between host and device */
#define VULKAN_SETS       1024           /* passes between two sendings */
#define VULKAN_BINDINGS   15             /* of a pass, at most */
#define VULKAN_BATCH      64             /* splats that raster.comp holds at a time */
#define VULKAN_SCAN_WHOLE (16u << 10)    /* numbers that one workgroup scans on its own: fewer passes, though longer ones */
#define VULKAN_WAIT       60000000000ull /* ns: a device that takes longer for a sending is given up */
enum {
    VULKAN_VARIANTS    = 4,
    VULKAN_ASKED       = 128, /* pieces that the host waits for at a time */
    VULKAN_PHOTO_SHARE = 4    /* of the device's memory, its inverse: photographs are kept there up to so much */
};

/* ---------------------------------------------------------------- functions of the loader, by name */

/* clang-format off */ /* it would make a staircase of these */
#define VULKAN_OF_LOADER(X) X(CreateInstance) X(EnumerateInstanceLayerProperties)
#define VULKAN_OF_INSTANCE(X) \
    X(DestroyInstance) X(EnumeratePhysicalDevices) X(GetPhysicalDeviceProperties) X(GetPhysicalDeviceMemoryProperties) \
    X(GetPhysicalDeviceQueueFamilyProperties) X(CreateDevice) X(GetDeviceProcAddr)
#define VULKAN_OF_DEVICE(X) \
    X(DestroyDevice) X(GetDeviceQueue) X(DeviceWaitIdle) X(CreateBuffer) X(DestroyBuffer) X(GetBufferMemoryRequirements) \
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

/* ---------------------------------------------------------------- the table of passes */

enum vulkan_pass {
    PASS_PROJECT,
    PASS_SCAN,
    PASS_COMPACT,
    PASS_SORT_COUNT,
    PASS_SORT_SCATTER,
    PASS_FOOTPRINT,
    PASS_RANGES,
    PASS_RASTER,
    PASS_RASTER_BACKWARD,
    PASS_LOSS_FORWARD,
    PASS_LOSS_TOTAL,
    PASS_LOSS_BACKWARD,
    PASS_PROJECT_BACKWARD,
    PASS_ADAM,
    PASS_OBSERVE,
    PASS_SCORE,
    PASS_UNPACK,
    PASS_PEAK, /* of the benchmark alone */
    PASS_COUNT
};

#define VULKAN_PASS(name) [PASS_##name] = {SPIRV_##name, sizeof SPIRV_##name, SPIRV_##name##_BINDINGS, SPIRV_##name##_PUSH}
static const struct {
    const uint32_t *words;
    size_t          bytes;
    uint32_t        bindings, push; /* storage buffers, in the shader's order; bytes of push constants: as the shader has them */
} VULKAN_PASSES[PASS_COUNT] = {
    VULKAN_PASS(PROJECT),          VULKAN_PASS(SCAN),         VULKAN_PASS(COMPACT),    VULKAN_PASS(SORT_COUNT),
    VULKAN_PASS(SORT_SCATTER),     VULKAN_PASS(FOOTPRINT),    VULKAN_PASS(RANGES),     VULKAN_PASS(RASTER),
    VULKAN_PASS(RASTER_BACKWARD),  VULKAN_PASS(LOSS_FORWARD), VULKAN_PASS(LOSS_TOTAL), VULKAN_PASS(LOSS_BACKWARD),
    VULKAN_PASS(PROJECT_BACKWARD), VULKAN_PASS(ADAM),         VULKAN_PASS(OBSERVE),    VULKAN_PASS(SCORE),
    VULKAN_PASS(UNPACK),           VULKAN_PASS(PEAK),
};

struct vulkan_pipeline {
    VkDescriptorSetLayout set;
    VkPipelineLayout      layout;
    VkPipeline            variant[VULKAN_VARIANTS]; /* made when first run */
};

struct vulkan_buffer {
    VkBuffer       handle;
    VkDeviceMemory memory;
    VkDeviceSize   size;
};

struct vulkan_asked { /* something that the host waits for */
    void  *to;
    size_t at, size; /* in the staging buffer */
};

struct vulkan {
    oxl_context *ctx;
    void        *library;
    VULKAN_OF_LOADER(VULKAN_DECLARE)
    VULKAN_OF_INSTANCE(VULKAN_DECLARE)
    VULKAN_OF_DEVICE(VULKAN_DECLARE)
    PFN_vkGetInstanceProcAddr        GetInstanceProcAddr;
    VkInstance                       instance;
    VkDebugUtilsMessengerEXT         messenger;
    int                              validates, complaints; /* whether the validation layer listens; what it said */
    VkPhysicalDevice                 physical;
    VkPhysicalDeviceProperties       properties;
    VkPhysicalDeviceMemoryProperties memory;
    VkDevice                         device;
    VkQueue                          queue;
    VkCommandPool                    command_pool;
    VkCommandBuffer                  commands;
    VkDescriptorPool                 descriptor_pool;
    VkFence                          fence;
    struct vulkan_pipeline           pipeline[PASS_COUNT];
    struct vulkan_buffer             staging, nothing; /* nothing: for bindings that a pass does not use */
    char                            *mapped;           /* staging, as the host sees it */
    size_t                           staged;           /* bytes of it in use */
    size_t                           sent;             /* bytes that vulkan_upload took there so far: for tests */
    struct vulkan_asked              ask[VULKAN_ASKED];
    int                              asked;
    int                              recording, sets;
    VkQueryPool                      clock;                /* (2 VULKAN_SETS) see vulkan_measure */
    uint8_t                          pass_at[VULKAN_SETS]; /* of the sets in use: which pass */
    double                           pass_seconds[PASS_COUNT];
    int                              pass_runs[PASS_COUNT];
    oxl_result                       rc;
    size_t                           range;      /* bytes: the largest array */
    size_t                           photos;     /* bytes of photographs that a renderer may keep */
    uint32_t                         slab_rows;  /* at most */
    uint32_t                         groups_max; /* in one dimension of a dispatch */
    uint32_t                         batch;      /* splats that raster_backward.comp holds at a time */
};

/* ---------------------------------------------------------------- what went wrong */

static const char *vulkan_word(VkResult result)
{
    switch (result) {
    case VK_TIMEOUT: return "it did not answer in time";
    case VK_ERROR_OUT_OF_HOST_MEMORY: return "no host memory";
    case VK_ERROR_OUT_OF_DEVICE_MEMORY: return "no device memory";
    case VK_ERROR_DEVICE_LOST: return "the device is lost";
    case VK_ERROR_INITIALIZATION_FAILED: return "it could not be started";
    case VK_ERROR_INCOMPATIBLE_DRIVER: return "no driver";
    default: return "refused";
    }
}

/* Keeps the first failure. 1: all is well. */
static int vulkan_ok(struct vulkan *v, VkResult result, const char *what)
{
    const int memory = result == VK_ERROR_OUT_OF_HOST_MEMORY || result == VK_ERROR_OUT_OF_DEVICE_MEMORY;
    if (result == VK_SUCCESS) return v->rc == OXL_OK;
    if (v->rc == OXL_OK)
        v->rc = oxl_fail(v->ctx, memory ? OXL_ERR_MEMORY : OXL_ERR_FAILED, "Vulkan, %s: %s (%d)\nfix: --backend cpu", what,
                         vulkan_word(result), (int)result);
    return 0;
}

/* ---------------------------------------------------------------- loader and instance */

static const char *const VULKAN_LIBRARY[] = {"libvulkan.so.1", "libvulkan.so", "vulkan-1.dll", "libvulkan.1.dylib"};

static int vulkan_load(struct vulkan *v)
{
    const char *named = getenv("OXL_VULKAN_LIBRARY"); /* another loader; a name that is not there: a machine without one */
    for (size_t i = 0; !named && !v->library && i < OXL_COUNT(VULKAN_LIBRARY); i++)
        v->library = os_library_open(VULKAN_LIBRARY[i]);
    if (named) v->library = os_library_open(named);
    if (!v->library) return 0;
    os_library_symbol(v->library, "vkGetInstanceProcAddr", &v->GetInstanceProcAddr, sizeof v->GetInstanceProcAddr);
    if (!v->GetInstanceProcAddr) return 0;
#define VULKAN_FIND(name) v->name = (PFN_vk##name)v->GetInstanceProcAddr(NULL, "vk" #name);
    VULKAN_OF_LOADER(VULKAN_FIND)
#undef VULKAN_FIND
    return v->CreateInstance != NULL;
}

static VKAPI_ATTR VkBool32 VKAPI_CALL vulkan_complaint(VkDebugUtilsMessageSeverityFlagBitsEXT      severity,
                                                       VkDebugUtilsMessageTypeFlagsEXT             types,
                                                       const VkDebugUtilsMessengerCallbackDataEXT *data, void *user)
{
    struct vulkan *v = user;
    (void)severity, (void)types;
    if (v->complaints++ < 10) oxl_log(v->ctx, OXL_LOG_WARNING, "Vulkan validation: %s", data->pMessage);
    return VK_FALSE;
}

static const char *const VULKAN_VALIDATION = "VK_LAYER_KHRONOS_validation";

/* The validation layer is for those who change this file: OXL_VULKAN_VALIDATE=1, and installed. */
static int vulkan_validates(struct vulkan *v)
{
    VkLayerProperties layer[64];
    uint32_t          count = OXL_COUNT(layer);
    if (!getenv("OXL_VULKAN_VALIDATE") || !v->EnumerateInstanceLayerProperties) return 0;
    if (v->EnumerateInstanceLayerProperties(&count, layer) < 0) return 0;
    for (uint32_t i = 0; i < count; i++)
        if (strcmp(layer[i].layerName, VULKAN_VALIDATION) == 0) return 1;
    return 0;
}

/* The layer is asked for by what is chained to the instance: it listens from the first call, and for missing barriers too. */
static VkResult vulkan_make_instance(struct vulkan *v, int validates, const VkDebugUtilsMessengerCreateInfoEXT *listen)
{
    const VkValidationFeatureEnableEXT also        = VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT;
    const VkValidationFeaturesEXT      features    = {.sType                         = VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT,
                                                      .pNext                         = listen,
                                                      .enabledValidationFeatureCount = 1,
                                                      .pEnabledValidationFeatures    = &also};
    const char *const                  extension   = VK_EXT_DEBUG_UTILS_EXTENSION_NAME;
    const VkApplicationInfo            application = {
                   .sType = VK_STRUCTURE_TYPE_APPLICATION_INFO, .pApplicationName = "oceanxl", .apiVersion = VK_API_VERSION_1_0};
    const VkInstanceCreateInfo info = {.sType                   = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
                                       .pNext                   = validates ? &features : NULL,
                                       .pApplicationInfo        = &application,
                                       .enabledLayerCount       = validates ? 1u : 0u,
                                       .ppEnabledLayerNames     = &VULKAN_VALIDATION,
                                       .enabledExtensionCount   = validates ? 1u : 0u,
                                       .ppEnabledExtensionNames = &extension};
    return v->CreateInstance(&info, NULL, &v->instance);
}

static oxl_result vulkan_start(struct vulkan *v)
{
    const VkDebugUtilsMessengerCreateInfoEXT listen = {
        .sType           = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT,
        .messageSeverity = VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT,
        .messageType     = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT,
        .pfnUserCallback = vulkan_complaint,
        .pUserData       = v};
    PFN_vkCreateDebugUtilsMessengerEXT create;
    if (!vulkan_load(v))
        return oxl_fail(v->ctx, OXL_ERR_FAILED,
                        "no Vulkan loader (libvulkan.so.1) on this machine\nfix: install a driver, or --backend cpu");
    v->validates = vulkan_validates(v);
    if (!vulkan_ok(v, vulkan_make_instance(v, v->validates, &listen), "the loader")) return v->rc;
#define VULKAN_FIND(name) v->name = (PFN_vk##name)v->GetInstanceProcAddr(v->instance, "vk" #name);
    VULKAN_OF_INSTANCE(VULKAN_FIND)
#undef VULKAN_FIND
    if (!v->validates) return OXL_OK;
    create = (PFN_vkCreateDebugUtilsMessengerEXT)v->GetInstanceProcAddr(v->instance, "vkCreateDebugUtilsMessengerEXT");
    if (create) vulkan_ok(v, create(v->instance, &listen, NULL, &v->messenger), "the validation layer");
    return v->rc;
}

static void vulkan_stop(struct vulkan *v)
{
    PFN_vkDestroyDebugUtilsMessengerEXT destroy;
    if (v->messenger) {
        destroy = (PFN_vkDestroyDebugUtilsMessengerEXT)v->GetInstanceProcAddr(v->instance, "vkDestroyDebugUtilsMessengerEXT");
        if (destroy) destroy(v->instance, v->messenger, NULL);
    }
    if (v->instance) v->DestroyInstance(v->instance, NULL);
    if (v->library) os_library_close(v->library);
}

/* ---------------------------------------------------------------- devices */

enum { VULKAN_DEVICES = 32 };

static uint32_t vulkan_devices(struct vulkan *v, VkPhysicalDevice device[VULKAN_DEVICES])
{
    uint32_t count = VULKAN_DEVICES;
    return v->EnumeratePhysicalDevices(v->instance, &count, device) < 0 ? 0 : count;
}

static const char *vulkan_kind(VkPhysicalDeviceType type)
{
    switch (type) {
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU: return "discrete GPU";
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU: return "integrated GPU";
    case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU: return "virtual GPU";
    case VK_PHYSICAL_DEVICE_TYPE_CPU: return "the CPU in disguise";
    default: return "unknown kind";
    }
}

/* Better ones first. */
static int vulkan_rank(VkPhysicalDeviceType type)
{
    switch (type) {
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU: return 4;
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU: return 3;
    case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU: return 2;
    case VK_PHYSICAL_DEVICE_TYPE_CPU: return 0;
    default: return 1;
    }
}

OXL_INTERNAL oxl_result vulkan_list(oxl_context *ctx, struct text *out)
{
    struct vulkan    v = {.ctx = ctx};
    VkPhysicalDevice device[VULKAN_DEVICES];
    uint32_t         count = 0;
    if (vulkan_start(&v) == OXL_OK) {
        count = vulkan_devices(&v, device);
        if (count == 0) v.rc = oxl_fail(ctx, OXL_ERR_FAILED, "Vulkan knows of no device here");
    } else v.rc = ctx->failed;
    for (uint32_t i = 0; i < count; i++) {
        VkPhysicalDeviceProperties p;
        v.GetPhysicalDeviceProperties(device[i], &p);
        text_add(out, "%u  %s (%s), Vulkan %u.%u.%u, arrays of %u MiB at most\n", i, p.deviceName, vulkan_kind(p.deviceType),
                 VK_VERSION_MAJOR(p.apiVersion), VK_VERSION_MINOR(p.apiVersion), VK_VERSION_PATCH(p.apiVersion),
                 p.limits.maxStorageBufferRange >> 20);
    }
    vulkan_stop(&v);
    return v.rc;
}

static oxl_result vulkan_choose(struct vulkan *v, int wanted, int any)
{
    VkPhysicalDevice device[VULKAN_DEVICES];
    const uint32_t   count = vulkan_devices(v, device);
    int              best  = -1;
    if (count == 0) return oxl_fail(v->ctx, OXL_ERR_FAILED, "Vulkan knows of no device here\nfix: --backend cpu");
    if (wanted >= (int)count)
        return oxl_fail(v->ctx, OXL_ERR_USAGE, "device %d of %u\nfix: oceanxl info --devices has the list, from 0", wanted,
                        count);
    for (uint32_t i = 0; i < count; i++) {
        VkPhysicalDeviceProperties p;
        v->GetPhysicalDeviceProperties(device[i], &p);
        if (wanted >= 0 ? (int)i != wanted : vulkan_rank(p.deviceType) <= best) continue;
        if (wanted < 0 && !any && p.deviceType == VK_PHYSICAL_DEVICE_TYPE_CPU) continue;
        best          = vulkan_rank(p.deviceType);
        v->physical   = device[i];
        v->properties = p;
    }
    if (best < 0) return oxl_fail(v->ctx, OXL_ERR_FAILED, "Vulkan knows of no device here but the CPU");
    v->GetPhysicalDeviceMemoryProperties(v->physical, &v->memory);
    for (uint32_t i = 0; i < v->memory.memoryHeapCount; i++)
        if (v->memory.memoryHeaps[i].flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT)
            v->photos = OXL_MAX(v->photos, (size_t)(v->memory.memoryHeaps[i].size / VULKAN_PHOTO_SHARE));
    return OXL_OK;
}

/* What the passes ask for; most of it is what Vulkan 1.0 promises of any device, the bindings are not. */
static oxl_result vulkan_check(struct vulkan *v)
{
    const VkPhysicalDeviceLimits *l = &v->properties.limits;
    v->range                        = l->maxStorageBufferRange;
    v->groups_max                   = OXL_MIN(l->maxComputeWorkGroupCount[0], l->maxComputeWorkGroupCount[1]);
    v->batch                        = l->maxComputeSharedMemorySize >= 32768 ? 8 : 4;
    v->slab_rows = (uint32_t)OXL_MIN(VULKAN_SLAB_ROWS, v->range / (sizeof(float) * OXL_PLANES) / VULKAN_GROUP * VULKAN_GROUP);
    if (l->maxPerStageDescriptorStorageBuffers >= VULKAN_BINDINGS && l->maxComputeWorkGroupInvocations >= VULKAN_GROUP &&
        l->maxComputeWorkGroupSize[0] >= VULKAN_GROUP && l->maxComputeSharedMemorySize >= 16384 && v->slab_rows > 0)
        return OXL_OK;
    return oxl_fail(
        v->ctx, OXL_ERR_FAILED,
        "%s: %u storage buffers a shader, %u invocations a workgroup, %u bytes shared: wanted %d, %u, 16384\nfix: another "
        "--device, or --backend cpu",
        v->properties.deviceName, l->maxPerStageDescriptorStorageBuffers, l->maxComputeWorkGroupInvocations,
        l->maxComputeSharedMemorySize, VULKAN_BINDINGS, VULKAN_GROUP);
}

static oxl_result vulkan_open_device(struct vulkan *v)
{
    VkQueueFamilyProperties family[64];
    uint32_t                count = OXL_COUNT(family), chosen = 0;
    const float             priority = 1;
    VkDeviceQueueCreateInfo queue    = {
           .sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO, .queueCount = 1, .pQueuePriorities = &priority};
    const VkDeviceCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO, .queueCreateInfoCount = 1, .pQueueCreateInfos = &queue};
    VkCommandPoolCreateInfo          pool     = {.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
    VkCommandBufferAllocateInfo      commands = {.sType              = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
                                                 .level              = VK_COMMAND_BUFFER_LEVEL_PRIMARY,
                                                 .commandBufferCount = 1};
    const VkFenceCreateInfo          fence    = {.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO};
    const VkDescriptorPoolSize       size     = {VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, VULKAN_SETS * VULKAN_BINDINGS};
    const VkDescriptorPoolCreateInfo sets     = {
            .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO, .maxSets = VULKAN_SETS, .poolSizeCount = 1, .pPoolSizes = &size};
    v->GetPhysicalDeviceQueueFamilyProperties(v->physical, &count, family);
    while (chosen < count && !(family[chosen].queueFlags & VK_QUEUE_COMPUTE_BIT)) chosen++;
    if (chosen == count)
        return oxl_fail(v->ctx, OXL_ERR_FAILED, "%s cannot compute\nfix: --backend cpu", v->properties.deviceName);
    queue.queueFamilyIndex = pool.queueFamilyIndex = chosen;
    if (!vulkan_ok(v, v->CreateDevice(v->physical, &info, NULL, &v->device), v->properties.deviceName)) return v->rc;
#define VULKAN_FIND(name) v->name = (PFN_vk##name)v->GetDeviceProcAddr(v->device, "vk" #name);
    VULKAN_OF_DEVICE(VULKAN_FIND)
#undef VULKAN_FIND
    v->GetDeviceQueue(v->device, chosen, 0, &v->queue);
    if (!vulkan_ok(v, v->CreateCommandPool(v->device, &pool, NULL, &v->command_pool), "a command pool")) return v->rc;
    commands.commandPool = v->command_pool;
    if (vulkan_ok(v, v->AllocateCommandBuffers(v->device, &commands, &v->commands), "a command buffer") &&
        vulkan_ok(v, v->CreateFence(v->device, &fence, NULL, &v->fence), "a fence"))
        vulkan_ok(v, v->CreateDescriptorPool(v->device, &sets, NULL, &v->descriptor_pool), "descriptors");
    return v->rc;
}

/* ---------------------------------------------------------------- buffers */

/* A kind of memory with all of the properties, those that are also `preferred` first; -1: none. */
static int vulkan_memory_kind(const struct vulkan *v, uint32_t allowed, VkMemoryPropertyFlags needed,
                              VkMemoryPropertyFlags preferred)
{
    for (int strict = 1; strict >= 0; strict--)
        for (uint32_t i = 0; i < v->memory.memoryTypeCount; i++) {
            const VkMemoryPropertyFlags has = v->memory.memoryTypes[i].propertyFlags, want = strict ? needed | preferred : needed;
            if ((allowed >> i & 1) && (has & want) == want) return (int)i;
        }
    return -1;
}

static void vulkan_release(struct vulkan *v, struct vulkan_buffer *b)
{
    if (b->handle) v->DestroyBuffer(v->device, b->handle, NULL);
    if (b->memory) v->FreeMemory(v->device, b->memory, NULL);
    *b = (struct vulkan_buffer){0};
}

static void vulkan_create(struct vulkan *v, struct vulkan_buffer *b, size_t size, int for_host)
{
    const VkBufferCreateInfo    info   = {.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO,
                                          .size  = size,
                                          .usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_TRANSFER_SRC_BIT |
                                                   VK_BUFFER_USAGE_TRANSFER_DST_BIT};
    const VkMemoryPropertyFlags host   = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    VkMemoryAllocateInfo        memory = {.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO};
    VkMemoryRequirements        needs;
    int                         kind;
    if (!vulkan_ok(v, v->CreateBuffer(v->device, &info, NULL, &b->handle), "a buffer")) return;
    v->GetBufferMemoryRequirements(v->device, b->handle, &needs);
    kind                   = vulkan_memory_kind(v, needs.memoryTypeBits, for_host ? host : 0,
                              for_host ? VK_MEMORY_PROPERTY_HOST_CACHED_BIT : VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
    memory.allocationSize  = needs.size;
    memory.memoryTypeIndex = (uint32_t)OXL_MAX(kind, 0);
    if (kind < 0) vulkan_ok(v, VK_ERROR_FEATURE_NOT_PRESENT, "memory that the host can see");
    else if (vulkan_ok(v, v->AllocateMemory(v->device, &memory, NULL, &b->memory), "memory for a buffer"))
        vulkan_ok(v, v->BindBufferMemory(v->device, b->handle, b->memory, 0), "memory for a buffer");
    if (v->rc == OXL_OK) b->size = size;
    else vulkan_release(v, b);
}

static oxl_result vulkan_finish(struct vulkan *v);

/* At least so many elements; what it held is lost. */
static void vulkan_reserve(struct vulkan *v, struct vulkan_buffer *b, size_t count, size_t element, const char *what)
{
    const size_t least = OXL_MAX(count, (size_t)1) * element, roomy = OXL_MIN(least + least / 4, v->range) & ~(size_t)15;
    if (v->rc != OXL_OK || b->size >= least) return;
    if (least > v->range || count > SIZE_MAX / element) {
        v->rc = oxl_fail(v->ctx, OXL_ERR_FAILED,
                         "%s: %zu %s need %zu MiB in one array, %zu MiB is the most here\nfix: a smaller "
                         "--max-side, fewer --max-gaussians, or --backend cpu",
                         v->properties.deviceName, count, what, least >> 20, v->range >> 20);
        return;
    }
    if (b->handle && vulkan_finish(v) != OXL_OK) return; /* commands under way may name it */
    vulkan_release(v, b);
    vulkan_create(v, b, OXL_MAX(OXL_MAX(roomy, least), (size_t)256), 0);
}

/* ---------------------------------------------------------------- recording and sending */

static int vulkan_record(struct vulkan *v)
{
    const VkCommandBufferBeginInfo begin = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO,
                                            .flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT};
    if (v->rc != OXL_OK || v->recording) return v->rc == OXL_OK;
    if (!vulkan_ok(v, v->BeginCommandBuffer(v->commands, &begin), "recording")) return 0;
    v->recording = 1;
    if (v->clock) v->CmdResetQueryPool(v->commands, v->clock, 0, 2 * VULKAN_SETS);
    return 1;
}

/* From now on each pass is timed by the device's own clock, into pass_seconds and pass_runs. For the benchmark. */
OXL_INTERNAL oxl_result vulkan_measure(struct vulkan *v)
{
    const VkQueryPoolCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO, .queryType = VK_QUERY_TYPE_TIMESTAMP, .queryCount = 2 * VULKAN_SETS};
    if (!v->properties.limits.timestampComputeAndGraphics)
        return oxl_fail(v->ctx, OXL_ERR_FAILED, "%s has no clock", v->properties.deviceName);
    if (!v->clock) vulkan_ok(v, v->CreateQueryPool(v->device, &info, NULL, &v->clock), "a clock");
    return v->rc;
}

/* Before (0) and after (1) the pass that is recorded next. What went before has ended: the barrier behind it sees to that. */
static void vulkan_stamp(struct vulkan *v, enum vulkan_pass pass, uint32_t after)
{
    const uint32_t set = (uint32_t)v->sets - 1;
    if (!v->clock) return;
    v->pass_at[set] = (uint8_t)pass;
    v->CmdWriteTimestamp(v->commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, v->clock, 2 * set + after);
}

static void vulkan_read_clock(struct vulkan *v)
{
    uint64_t stamp[2 * VULKAN_SETS];
    if (!v->clock || v->sets == 0) return;
    if (v->GetQueryPoolResults(v->device, v->clock, 0, 2 * (uint32_t)v->sets, sizeof stamp, stamp, sizeof *stamp,
                               VK_QUERY_RESULT_64_BIT | VK_QUERY_RESULT_WAIT_BIT) != VK_SUCCESS)
        return;
    for (int i = 0; i < v->sets; i++) {
        v->pass_seconds[v->pass_at[i]] += 1e-9 * v->properties.limits.timestampPeriod * (double)(stamp[2 * i + 1] - stamp[2 * i]);
        v->pass_runs[v->pass_at[i]]++;
    }
}

/* What was recorded before is done, and seen, before what comes. */
static void vulkan_barrier(struct vulkan *v)
{
    const VkMemoryBarrier      barrier = {.sType         = VK_STRUCTURE_TYPE_MEMORY_BARRIER,
                                          .srcAccessMask = VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT,
                                          .dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT |
                                                           VK_ACCESS_TRANSFER_READ_BIT | VK_ACCESS_TRANSFER_WRITE_BIT |
                                                           VK_ACCESS_HOST_READ_BIT};
    const VkPipelineStageFlags from    = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT;
    v->CmdPipelineBarrier(v->commands, from, from | VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &barrier, 0, NULL, 0, NULL);
}

/* Sends what was recorded and waits for it. */
static oxl_result vulkan_finish(struct vulkan *v)
{
    const VkSubmitInfo submit = {
        .sType = VK_STRUCTURE_TYPE_SUBMIT_INFO, .commandBufferCount = 1, .pCommandBuffers = &v->commands};
    if (v->recording) {
        if (vulkan_ok(v, v->EndCommandBuffer(v->commands), "recording") &&
            vulkan_ok(v, v->QueueSubmit(v->queue, 1, &submit, v->fence), "a sending") &&
            vulkan_ok(v, v->WaitForFences(v->device, 1, &v->fence, VK_TRUE, VULKAN_WAIT), "a sending"))
            vulkan_ok(v, v->ResetFences(v->device, 1, &v->fence), "a fence");
        if (v->rc != OXL_OK) v->DeviceWaitIdle(v->device);
        else vulkan_read_clock(v);
        v->ResetCommandPool(v->device, v->command_pool, 0);
        v->ResetDescriptorPool(v->device, v->descriptor_pool, 0);
        v->recording = v->sets = 0;
    }
    v->staged = 0;
    return v->rc;
}

/* Every door begins so: what was recorded before a failure is dropped, for what it works on may not be there. */
static void vulkan_enter(struct vulkan *v)
{
    if (v->rc != OXL_OK && v->recording) {
        v->ResetCommandPool(v->device, v->command_pool, 0);
        v->ResetDescriptorPool(v->device, v->descriptor_pool, 0);
        v->recording = v->sets = v->asked = 0;
        v->staged                         = 0;
    }
    v->rc = OXL_OK;
}

/* A place of `size` bytes in the staging buffer for what is recorded next. */
static size_t vulkan_stage(struct vulkan *v, size_t size)
{
    size_t at;
    if (v->staged + size > VULKAN_STAGING) vulkan_finish(v);
    at        = v->staged;
    v->staged = (at + size + 15) & ~(size_t)15;
    return at;
}

static void vulkan_upload(struct vulkan *v, const struct vulkan_buffer *to, size_t offset, const void *from, size_t size)
{
    v->sent += size;
    for (size_t done = 0, piece; done < size && v->rc == OXL_OK; done += piece) {
        VkBufferCopy copy;
        size_t       at;
        piece = OXL_MIN(size - done, (size_t)VULKAN_STAGING);
        at    = vulkan_stage(v, piece);
        if (!vulkan_record(v)) return;
        memcpy(v->mapped + at, (const char *)from + done, piece);
        copy = (VkBufferCopy){at, offset + done, piece};
        v->CmdCopyBuffer(v->commands, v->staging.handle, to->handle, 1, &copy);
        vulkan_barrier(v);
    }
}

/* Waits for all that was recorded, and hands out what was asked for. */
static void vulkan_collect(struct vulkan *v)
{
    const int asked = v->asked;
    v->asked        = 0;
    if (vulkan_finish(v) != OXL_OK) return;
    for (int i = 0; i < asked; i++) memcpy(v->ask[i].to, v->mapped + v->ask[i].at, v->ask[i].size);
}

/* `to` is filled by vulkan_collect, which must come before anything else is sent: many small pieces, one wait. */
static void vulkan_ask(struct vulkan *v, const struct vulkan_buffer *from, size_t offset, void *to, size_t size)
{
    for (size_t done = 0, piece; done < size && v->rc == OXL_OK; done += piece) {
        VkBufferCopy copy;
        piece = OXL_MIN(size - done, (size_t)VULKAN_STAGING);
        if (v->staged + piece > VULKAN_STAGING || v->asked == VULKAN_ASKED) vulkan_collect(v);
        if (!vulkan_record(v)) return;
        copy               = (VkBufferCopy){offset + done, vulkan_stage(v, piece), piece};
        v->ask[v->asked++] = (struct vulkan_asked){(char *)to + done, copy.dstOffset, piece};
        v->CmdCopyBuffer(v->commands, from->handle, v->staging.handle, 1, &copy);
        vulkan_barrier(v);
    }
}

static void vulkan_download(struct vulkan *v, const struct vulkan_buffer *from, size_t offset, void *to, size_t size)
{
    vulkan_ask(v, from, offset, to, size);
    vulkan_collect(v);
}

/* A few words, kept in the command itself. */
static void vulkan_update(struct vulkan *v, const struct vulkan_buffer *to, size_t offset, const void *from, size_t size)
{
    if (!vulkan_record(v)) return;
    v->CmdUpdateBuffer(v->commands, to->handle, offset, size, from);
    vulkan_barrier(v);
}

static void vulkan_fill(struct vulkan *v, const struct vulkan_buffer *to, uint32_t value)
{
    if (!vulkan_record(v)) return;
    v->CmdFillBuffer(v->commands, to->handle, 0, VK_WHOLE_SIZE, value);
    vulkan_barrier(v);
}

/* ---------------------------------------------------------------- running a pass */

static void vulkan_make_layout(struct vulkan *v, enum vulkan_pass pass)
{
    struct vulkan_pipeline          *p = &v->pipeline[pass];
    VkDescriptorSetLayoutBinding     binding[VULKAN_BINDINGS];
    const VkPushConstantRange        push   = {VK_SHADER_STAGE_COMPUTE_BIT, 0, VULKAN_PASSES[pass].push};
    VkDescriptorSetLayoutCreateInfo  set    = {.sType        = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO,
                                               .bindingCount = VULKAN_PASSES[pass].bindings,
                                               .pBindings    = binding};
    const VkPipelineLayoutCreateInfo layout = {.sType                  = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO,
                                               .setLayoutCount         = 1,
                                               .pSetLayouts            = &p->set,
                                               .pushConstantRangeCount = 1,
                                               .pPushConstantRanges    = &push};
    for (uint32_t i = 0; i < VULKAN_PASSES[pass].bindings; i++)
        binding[i] = (VkDescriptorSetLayoutBinding){i, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, VK_SHADER_STAGE_COMPUTE_BIT, NULL};
    if (vulkan_ok(v, v->CreateDescriptorSetLayout(v->device, &set, NULL, &p->set), "a layout"))
        vulkan_ok(v, v->CreatePipelineLayout(v->device, &layout, NULL, &p->layout), "a layout");
}

static void vulkan_make_variant(struct vulkan *v, enum vulkan_pass pass, uint32_t variant)
{
    const uint32_t                 constants[2] = {variant, pass == PASS_RASTER ? VULKAN_BATCH : v->batch};
    const VkSpecializationMapEntry entry[2]     = {{0, 0, 4}, {1, 4, 4}};
    const VkSpecializationInfo     special      = {2, entry, sizeof constants, constants};
    const VkShaderModuleCreateInfo code         = {.sType    = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO,
                                                   .codeSize = VULKAN_PASSES[pass].bytes,
                                                   .pCode    = VULKAN_PASSES[pass].words};
    VkShaderModule                 module;
    VkComputePipelineCreateInfo    info = {.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
    if (!v->pipeline[pass].layout) vulkan_make_layout(v, pass);
    if (v->rc != OXL_OK || !vulkan_ok(v, v->CreateShaderModule(v->device, &code, NULL, &module), "a shader")) return;
    info.layout = v->pipeline[pass].layout;
    info.stage  = (VkPipelineShaderStageCreateInfo){.sType               = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
                                                    .stage               = VK_SHADER_STAGE_COMPUTE_BIT,
                                                    .module              = module,
                                                    .pName               = "main",
                                                    .pSpecializationInfo = &special};
    vulkan_ok(v, v->CreateComputePipelines(v->device, VK_NULL_HANDLE, 1, &info, NULL, &v->pipeline[pass].variant[variant]),
              "a shader");
    v->DestroyShaderModule(v->device, module, NULL);
}

static VkDescriptorSet vulkan_bind(struct vulkan *v, enum vulkan_pass pass, const struct vulkan_buffer *const *buffer)
{
    const uint32_t                    count = VULKAN_PASSES[pass].bindings;
    const VkDescriptorSetAllocateInfo info  = {.sType              = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO,
                                               .descriptorPool     = v->descriptor_pool,
                                               .descriptorSetCount = 1,
                                               .pSetLayouts        = &v->pipeline[pass].set};
    VkDescriptorSet                   set   = VK_NULL_HANDLE;
    VkDescriptorBufferInfo            whole[VULKAN_BINDINGS];
    VkWriteDescriptorSet              write = {.sType           = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET,
                                               .descriptorCount = count,
                                               .descriptorType  = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER,
                                               .pBufferInfo     = whole};
    if (!vulkan_ok(v, v->AllocateDescriptorSets(v->device, &info, &set), "descriptors")) return VK_NULL_HANDLE;
    for (uint32_t i = 0; i < count; i++)
        whole[i] =
            (VkDescriptorBufferInfo){buffer[i] && buffer[i]->handle ? buffer[i]->handle : v->nothing.handle, 0, VK_WHOLE_SIZE};
    write.dstSet = set;
    v->UpdateDescriptorSets(v->device, 1, &write, 0, NULL);
    return set;
}

/* Records a pass of so many workgroups, see VULKAN_RUN. buffer: NULL where the variant uses none. */
static void vulkan_run(struct vulkan *v, enum vulkan_pass pass, uint32_t variant, size_t groups, const void *push,
                       const struct vulkan_buffer *const *buffer)
{
    struct vulkan_pipeline *p      = &v->pipeline[pass];
    const size_t            across = OXL_MIN(groups, v->groups_max), down = across ? (groups + across - 1) / across : 0;
    VkDescriptorSet         set;
    if (v->rc != OXL_OK || groups == 0) return;
    if (v->sets == VULKAN_SETS) vulkan_finish(v);
    if (down > v->groups_max) {
        v->rc = oxl_fail(v->ctx, OXL_ERR_FAILED, "%s: %zu workgroups are more than it takes\nfix: --backend cpu",
                         v->properties.deviceName, groups);
        return;
    }
    if (!p->variant[variant]) vulkan_make_variant(v, pass, variant);
    if (!vulkan_record(v)) return;
    set = vulkan_bind(v, pass, buffer);
    if (v->rc != OXL_OK) return;
    v->sets++;
    v->CmdBindPipeline(v->commands, VK_PIPELINE_BIND_POINT_COMPUTE, p->variant[variant]);
    v->CmdBindDescriptorSets(v->commands, VK_PIPELINE_BIND_POINT_COMPUTE, p->layout, 0, 1, &set, 0, NULL);
    v->CmdPushConstants(v->commands, p->layout, VK_SHADER_STAGE_COMPUTE_BIT, 0, VULKAN_PASSES[pass].push, push);
    vulkan_stamp(v, pass, 0);
    v->CmdDispatch(v->commands, (uint32_t)across, (uint32_t)down, 1);
    vulkan_stamp(v, pass, 1);
    vulkan_barrier(v);
}

#define VULKAN_BUFFERS(...) ((const struct vulkan_buffer *const[]){__VA_ARGS__})
#define VULKAN_PUSH(...)    ((const uint32_t[]){__VA_ARGS__})

/* Records pass PASS_name. It does not compile where what is pushed or bound is not as long as the shader has it. */
#define VULKAN_SAME(a, b) ((void)sizeof(char[(a) == (b) ? 1 : -1]))
#define VULKAN_RUN(v, name, variant, groups, push, buffers)                                                                      \
    (VULKAN_SAME(sizeof(push), SPIRV_##name##_PUSH), VULKAN_SAME(sizeof(buffers) / sizeof(buffers)[0], SPIRV_##name##_BINDINGS), \
     vulkan_run(v, PASS_##name, variant, groups, push, buffers))

static size_t vulkan_groups(size_t items)
{
    return (items + VULKAN_GROUP - 1) / VULKAN_GROUP;
}

static size_t vulkan_blocks(size_t items)
{
    return (items + VULKAN_BLOCK - 1) / VULKAN_BLOCK;
}

static uint32_t vulkan_bits(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

/* ---------------------------------------------------------------- opening and closing */

OXL_INTERNAL oxl_result vulkan_open(oxl_context *ctx, int device, int any, struct vulkan **out)
{
    struct vulkan *v      = oxl_calloc(ctx, 1, sizeof *v);
    void          *mapped = NULL;
    oxl_result     rc;
    *out = NULL;
    if (!v) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the Vulkan backend");
    v->ctx = ctx;
    rc     = vulkan_start(v);
    if (rc == OXL_OK) rc = vulkan_choose(v, device, any);
    if (rc == OXL_OK) rc = vulkan_check(v);
    if (rc == OXL_OK) rc = vulkan_open_device(v);
    if (rc == OXL_OK) {
        vulkan_create(v, &v->staging, VULKAN_STAGING, 1);
        vulkan_create(v, &v->nothing, 256, 0);
        if (v->rc == OXL_OK) vulkan_ok(v, v->MapMemory(v->device, v->staging.memory, 0, VULKAN_STAGING, 0, &mapped), "staging");
        v->mapped = mapped;
        rc        = v->rc;
    }
    if (rc == OXL_OK) *out = v;
    else vulkan_close(v);
    return rc;
}

OXL_INTERNAL void vulkan_close(struct vulkan *v)
{
    if (!v) return;
    if (v->device && v->DeviceWaitIdle) {
        v->DeviceWaitIdle(v->device);
        for (int pass = 0; pass < PASS_COUNT; pass++) {
            struct vulkan_pipeline *p = &v->pipeline[pass];
            for (int i = 0; i < VULKAN_VARIANTS; i++) v->DestroyPipeline(v->device, p->variant[i], NULL);
            v->DestroyPipelineLayout(v->device, p->layout, NULL);
            v->DestroyDescriptorSetLayout(v->device, p->set, NULL);
        }
        vulkan_release(v, &v->staging);
        vulkan_release(v, &v->nothing);
        v->DestroyQueryPool(v->device, v->clock, NULL);
        v->DestroyDescriptorPool(v->device, v->descriptor_pool, NULL);
        v->DestroyFence(v->device, v->fence, NULL);
        v->DestroyCommandPool(v->device, v->command_pool, NULL);
        v->DestroyDevice(v->device, NULL);
    }
    vulkan_stop(v);
    oxl_free(v->ctx, v);
}

OXL_INTERNAL const char *vulkan_name(const struct vulkan *v)
{
    return v->properties.deviceName;
}

/* ---------------------------------------------------------------- a renderer */

struct vulkan_slab {
    struct vulkan_buffer parameter, gradient, first, second; /* (planes, stride) */
};

/* As shaders/view.glsl has it. */
struct vulkan_view {
    float    rotation[9], translation[3], eye[3], fx, fy, cx, cy, limit_x, limit_y, near_plane, background[3];
    uint32_t width, height, tiles_x, tiles_y;
};

struct vulkan_photo { /* (3,H,W) bytes, then from a word on the mask's (H,W) */
    struct vulkan_buffer bytes;
    uint32_t             width, height, mask_at; /* mask_at: bytes; 0: there is none */
};

enum vulkan_count { COUNT_VISIBLE, COUNT_PAIRS, COUNT_SCRATCH, COUNT_ASIDE, COUNT_FIRST_ASIDE, COUNTS = 8 };

struct vulkan_renderer {
    struct vulkan       *v;
    /* whose model this is, and what of it is here */
    oxl_model           *model, *first, *second; /* the host's; the last two since a step */
    const float         *plane;                  /* the host's first one: another is another model */
    size_t               count, lobes;
    int                  sh_degree, bands; /* carried; evaluated */
    int                  model_here, moments_here, stepped;
    struct renderer_sums sums;
    int                  observed; /* there are statistics here that the host has not got */
    struct vulkan_slab  *slab;
    size_t               slabs, slab_capacity;
    uint32_t             stride;             /* rows of a slab */
    uint32_t             planes, lobe_plane; /* of a slab; where the second lobe's begin */
    /* photographs */
    struct vulkan_photo *photo;                               /* (photo_capacity) by view, those that are here */
    size_t               photo_capacity, photo_bytes, photos; /* photos: how many are here */
    int                  masked;                              /* whether the one that was taken last is */
    /* the last view */
    struct vulkan_view   view;
    size_t               tiles, pairs;
    int                  sort_end; /* which of the pairs' key and value buffers holds the sorted ones */
    /* from here on nothing but buffers: vulkan_renderer_free goes through them. By row */
    struct vulkan_buffer splat_a, splat_b, splat_c, lobe_a, lobe_b, seen, rank, row_key[2], row_value[2], row_pairs, row_slots,
        mean2d, statistics, score;
    /* by pair */
    struct vulkan_buffer pair_key[2], pair_value[2], staged, sums_a, sums_b, sums_c, sums_d, sums_e;
    /* by tile or pixel */
    struct vulkan_buffer start, rgb, drgb, target, weight, slope[3], partial,
        passing; /* passing: a photograph that is not kept */
    /* small, or of sorting and scanning */
    struct vulkan_buffer view_buffer, counts, rates, totals, histogram, scan_sums;
};

static void vulkan_renderer_free(void *device)
{
    struct vulkan_renderer *r = device;
    struct vulkan          *v = r->v;
    vulkan_finish(v);
    for (size_t at = offsetof(struct vulkan_renderer, splat_a); at < sizeof *r; at += sizeof(struct vulkan_buffer))
        vulkan_release(v, (struct vulkan_buffer *)((char *)r + at));
    for (size_t i = 0; i < r->slab_capacity; i++) {
        vulkan_release(v, &r->slab[i].parameter);
        vulkan_release(v, &r->slab[i].gradient);
        vulkan_release(v, &r->slab[i].first);
        vulkan_release(v, &r->slab[i].second);
    }
    for (size_t i = 0; i < r->photo_capacity; i++) vulkan_release(v, &r->photo[i].bytes);
    oxl_free(v->ctx, r->photo);
    oxl_free(v->ctx, r->slab);
    oxl_free(v->ctx, r);
}

static oxl_result vulkan_renderer_create(oxl_context *ctx, void **out)
{
    struct vulkan_renderer *r = oxl_calloc(ctx, 1, sizeof *r);
    struct vulkan          *v = ctx->vulkan;
    *out                      = NULL;
    if (!r) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a renderer");
    r->v = v;
    vulkan_enter(v);
    vulkan_reserve(v, &r->view_buffer, 1, sizeof r->view, "views");
    vulkan_reserve(v, &r->counts, COUNTS, sizeof(uint32_t), "numbers");
    vulkan_reserve(v, &r->rates, OXL_PLANES, sizeof(float), "numbers");
    vulkan_reserve(v, &r->totals, 5, sizeof(float), "numbers");
    if (v->rc == OXL_OK) *out = r;
    else vulkan_renderer_free(r);
    return v->rc;
}

/* ---------------------------------------------------------------- the model, there and back */

static size_t vulkan_slab_rows(const struct vulkan_renderer *r, size_t slab, size_t total)
{
    const size_t first = slab * r->stride;
    return total > first ? OXL_MIN(total - first, (size_t)r->stride) : 0;
}

static struct vulkan_buffer *vulkan_slab_part(struct vulkan_slab *slab, const struct vulkan_renderer *r, const oxl_model *m)
{
    return m == r->first ? &slab->first : m == r->second ? &slab->second : &slab->parameter;
}

static float *vulkan_host_plane(const oxl_model *m, const struct vulkan_renderer *r, uint32_t plane)
{
    return plane < r->lobe_plane ? m->plane[plane] : m->plane[OXL_LOBE + plane - r->lobe_plane];
}

/* Every plane of a model or of its moments, slab by slab. */
static void vulkan_copy_model(struct vulkan_renderer *r, oxl_model *m, int up)
{
    for (size_t s = 0; s < r->slabs; s++)
        for (uint32_t k = 0; k < r->planes; k++) {
            const size_t rows   = vulkan_slab_rows(r, s, k < r->lobe_plane ? r->count : r->lobes);
            const size_t offset = (size_t)k * r->stride * sizeof(float);
            float       *host   = vulkan_host_plane(m, r, k);
            if (rows == 0) continue;
            host += s * r->stride;
            if (up) vulkan_upload(r->v, vulkan_slab_part(&r->slab[s], r, m), offset, host, rows * sizeof(float));
            else vulkan_ask(r->v, vulkan_slab_part(&r->slab[s], r, m), offset, host, rows * sizeof(float));
        }
    if (!up) vulkan_collect(r->v);
}

static void vulkan_reserve_slabs(struct vulkan_renderer *r)
{
    struct vulkan *v      = r->v;
    const size_t   wanted = (r->count + v->slab_rows - 1) / v->slab_rows;
    r->stride             = (uint32_t)(wanted > 1 ? v->slab_rows : (r->count + VULKAN_GROUP - 1) / VULKAN_GROUP * VULKAN_GROUP);
    r->lobe_plane         = (uint32_t)(OXL_SH + 3 * (r->sh_degree + 1) * (r->sh_degree + 1));
    r->planes             = r->lobe_plane + (r->lobes ? MODEL_LOBE_PLANES : 0);
    if (wanted > r->slab_capacity) {
        struct vulkan_slab *more = oxl_regrow(v->ctx, r->slab, r->slab_capacity, wanted, sizeof *more);
        if (!more) v->rc = oxl_fail(v->ctx, OXL_ERR_MEMORY, "no memory for %zu slabs", wanted);
        if (!more) return;
        memset(more + r->slab_capacity, 0, (wanted - r->slab_capacity) * sizeof *more);
        r->slab          = more;
        r->slab_capacity = wanted;
    }
    r->slabs = wanted;
    for (size_t s = 0; s < r->slabs; s++)
        vulkan_reserve(v, &r->slab[s].parameter, (size_t)r->stride * r->planes, sizeof(float), "numbers of Gaussians");
}

static void vulkan_reserve_rows(struct vulkan_renderer *r)
{
    struct vulkan *v = r->v;
    const size_t   n = r->count;
    vulkan_reserve(v, &r->splat_a, n, 16, "Gaussians");
    vulkan_reserve(v, &r->splat_b, n, 16, "Gaussians");
    vulkan_reserve(v, &r->splat_c, n, 16, "Gaussians");
    vulkan_reserve(v, &r->row_slots, n, 8, "Gaussians");
    vulkan_reserve(v, &r->seen, n, 4, "Gaussians");
    vulkan_reserve(v, &r->rank, n, 4, "Gaussians");
    vulkan_reserve(v, &r->row_pairs, n, 4, "Gaussians");
    for (int k = 0; k < 2; k++) {
        vulkan_reserve(v, &r->row_key[k], n, 4, "Gaussians");
        vulkan_reserve(v, &r->row_value[k], n, 4, "Gaussians");
    }
    if (r->lobes) vulkan_reserve(v, &r->lobe_a, r->lobes, 16, "second lobes");
    if (r->lobes) vulkan_reserve(v, &r->lobe_b, r->lobes, 16, "second lobes");
    vulkan_reserve(v, &r->histogram, 16 * vulkan_blocks(n), 4, "Gaussians");
    vulkan_reserve(v, &r->scan_sums, vulkan_blocks(OXL_MAX(n, 16 * vulkan_blocks(n))), 4, "Gaussians");
}

/* The model, unless it is here already. */
static void vulkan_take_model(struct vulkan_renderer *r, const oxl_model *m)
{
    if (r->model_here && r->model == m && r->plane == m->plane[0] && r->count == m->count && r->lobes == m->lobes &&
        r->sh_degree == m->sh_degree)
        return;
    r->model = (oxl_model *)m; /* written in vulkan_fetch alone, when vulkan_step was given it as its own to write */
    r->first = r->second = NULL;
    r->plane             = m->plane[0];
    r->count = m->count, r->lobes = m->lobes, r->sh_degree = m->sh_degree;
    r->model_here = r->moments_here = r->stepped = 0;
    vulkan_reserve_slabs(r);
    vulkan_reserve_rows(r);
    if (r->v->rc == OXL_OK) vulkan_copy_model(r, r->model, 1);
    r->model_here = r->v->rc == OXL_OK;
}

static void vulkan_take_moments(struct vulkan_renderer *r, oxl_model *first, oxl_model *second)
{
    if (r->moments_here && r->first == first && r->second == second) return;
    r->first  = first;
    r->second = second;
    for (size_t s = 0; s < r->slabs; s++) {
        vulkan_reserve(r->v, &r->slab[s].first, (size_t)r->stride * r->planes, sizeof(float), "numbers of Gaussians");
        vulkan_reserve(r->v, &r->slab[s].second, (size_t)r->stride * r->planes, sizeof(float), "numbers of Gaussians");
    }
    vulkan_copy_model(r, first, 1);
    vulkan_copy_model(r, second, 1);
    r->moments_here = r->v->rc == OXL_OK;
}

/* The statistics of density control, there and back: what is added here is added to what the host has, number by number, so that a
 * run's result does not depend on when it was saved. */
static void vulkan_copy_sums(struct vulkan_renderer *r, int up)
{
    const struct renderer_sums *s = &r->sums;
    float(*sum)[4]                = oxl_alloc(r->v->ctx, s->count + 1, sizeof *sum);
    if (!sum) r->v->rc = oxl_fail(r->v->ctx, OXL_ERR_MEMORY, "no memory for the statistics of %zu Gaussians", s->count);
    for (size_t i = 0; up && sum && i < s->count; i++) {
        sum[i][0] = s->gradient[i], sum[i][3] = s->views[i];
        sum[i][1] = s->banded ? s->mid[i] : 0, sum[i][2] = s->banded ? s->far_[i] : 0;
    }
    if (up) vulkan_upload(r->v, &r->statistics, 0, sum, s->count * sizeof *sum);
    else vulkan_download(r->v, &r->statistics, 0, sum, s->count * sizeof *sum);
    for (size_t i = 0; !up && r->v->rc == OXL_OK && i < s->count; i++) {
        s->gradient[i] = sum[i][0], s->views[i] = sum[i][3];
        if (s->banded) s->mid[i] = sum[i][1], s->far_[i] = sum[i][2];
    }
    oxl_free(r->v->ctx, sum);
}

static oxl_result vulkan_fetch(void *device)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    if (r->stepped) {
        vulkan_copy_model(r, r->model, 0);
        vulkan_copy_model(r, r->first, 0);
        vulkan_copy_model(r, r->second, 0);
    }
    if (r->observed) vulkan_copy_sums(r, 0);
    r->model_here = r->moments_here = r->stepped = r->observed = 0;
    return r->v->rc;
}

/* ---------------------------------------------------------------- scanning and sorting */

/* Exclusive prefix sums of n numbers, in place; the total goes to counts[slot]. */
static void vulkan_scan(struct vulkan_renderer *r, const struct vulkan_buffer *in, const struct vulkan_buffer *out, size_t n,
                        enum vulkan_count slot)
{
    const uint32_t push[2] = {(uint32_t)n, slot}, sums[2] = {(uint32_t)vulkan_blocks(n), slot};
    if (n <= VULKAN_SCAN_WHOLE) {
        VULKAN_RUN(r->v, SCAN, 1, 1, push, VULKAN_BUFFERS(in, out, &r->counts, &r->scan_sums));
        return;
    }
    VULKAN_RUN(r->v, SCAN, 0, vulkan_blocks(n), push, VULKAN_BUFFERS(in, out, &r->counts, &r->scan_sums));
    VULKAN_RUN(r->v, SCAN, 1, 1, sums, VULKAN_BUFFERS(&r->scan_sums, &r->scan_sums, &r->counts, NULL));
    VULKAN_RUN(r->v, SCAN, 2, vulkan_blocks(n), push, VULKAN_BUFFERS(in, out, &r->counts, &r->scan_sums));
}

/* counts[slot] keys, `most` at most, by their lowest `bits`; returns which of the two holds them sorted. */
static int vulkan_sort(struct vulkan_renderer *r, struct vulkan_buffer key[2], struct vulkan_buffer value[2],
                       enum vulkan_count slot, size_t most, uint32_t bits)
{
    const size_t blocks = vulkan_blocks(most);
    int          at     = 0;
    for (uint32_t shift = 0; shift < bits; shift += 4, at ^= 1) {
        const uint32_t push[3] = {slot, shift, (uint32_t)blocks};
        VULKAN_RUN(r->v, SORT_COUNT, 0, blocks, push, VULKAN_BUFFERS(&r->counts, &key[at], &r->histogram));
        vulkan_scan(r, &r->histogram, &r->histogram, 16 * blocks, COUNT_SCRATCH);
        VULKAN_RUN(r->v, SORT_SCATTER, 0, blocks, push,
                   VULKAN_BUFFERS(&r->counts, &key[at], &r->histogram, &key[at ^ 1], &value[at], &value[at ^ 1]));
    }
    return at;
}

/* ---------------------------------------------------------------- forward */

static void vulkan_take_view(struct vulkan_renderer *r, const oxl_camera *c, const oxl_render_options *o)
{
    const struct lens l = render_lens(c, o->near_plane);
    r->view  = (struct vulkan_view){.rotation    = {l.rotation.x.x, l.rotation.x.y, l.rotation.x.z, l.rotation.y.x, l.rotation.y.y,
                                                    l.rotation.y.z, l.rotation.z.x, l.rotation.z.y, l.rotation.z.z},
                                    .translation = {l.translation.x, l.translation.y, l.translation.z},
                                    .eye         = {l.eye.x, l.eye.y, l.eye.z},
                                    .fx          = l.fx,
                                    .fy          = l.fy,
                                    .cx          = l.cx,
                                    .cy          = l.cy,
                                    .limit_x     = l.limit_x,
                                    .limit_y     = l.limit_y,
                                    .near_plane  = l.near_plane,
                                    .background  = {o->background[0], o->background[1], o->background[2]},
                                    .width       = (uint32_t)c->width,
                                    .height      = (uint32_t)c->height,
                                    .tiles_x     = (uint32_t)(c->width + TILE - 1) / TILE,
                                    .tiles_y     = (uint32_t)(c->height + TILE - 1) / TILE};
    r->tiles = (size_t)r->view.tiles_x * r->view.tiles_y;
    vulkan_reserve(r->v, &r->rgb, (size_t)c->width * (size_t)c->height, 12, "pixels");
    vulkan_reserve(r->v, &r->start, r->tiles + 1, 4, "tiles");
    vulkan_update(r->v, &r->view_buffer, 0, &r->view, sizeof r->view);
}

static void vulkan_row_push(const struct vulkan_renderer *r, size_t slab, uint32_t push[6])
{
    push[0] = (uint32_t)(slab * r->stride);
    push[1] = (uint32_t)vulkan_slab_rows(r, slab, r->count);
    push[2] = r->stride;
    push[3] = (uint32_t)r->bands;
    push[4] = (uint32_t)r->lobes;
    push[5] = r->lobe_plane;
}

static void vulkan_project(struct vulkan_renderer *r)
{
    uint32_t push[6];
    for (size_t s = 0; s < r->slabs; s++) {
        vulkan_row_push(r, s, push);
        VULKAN_RUN(r->v, PROJECT, 0, vulkan_groups(push[1]), push,
                   VULKAN_BUFFERS(&r->view_buffer, &r->slab[s].parameter, &r->splat_a, &r->splat_b, &r->splat_c, &r->seen,
                                  &r->lobe_a, &r->lobe_b));
    }
}

static void vulkan_footprint(struct vulkan_renderer *r, uint32_t variant)
{
    VULKAN_RUN(r->v, FOOTPRINT, variant, vulkan_groups(r->count),
               VULKAN_PUSH(COUNT_VISIBLE, (uint32_t)r->lobes, (uint32_t)r->count),
               VULKAN_BUFFERS(&r->view_buffer, &r->counts, &r->row_value[0], &r->splat_a, &r->splat_b, &r->lobe_a, &r->lobe_b,
                              &r->row_pairs, &r->pair_key[0], &r->pair_value[0], &r->staged, &r->row_slots));
}

/* Up to the number of pairs, which the host must know to make room. */
static void vulkan_order_rows(struct vulkan_renderer *r)
{
    struct vulkan *v     = r->v;
    uint32_t       pairs = 0;
    vulkan_project(r);
    vulkan_scan(r, &r->seen, &r->rank, r->count, COUNT_VISIBLE);
    VULKAN_RUN(v, COMPACT, 0, vulkan_groups(r->count), VULKAN_PUSH((uint32_t)r->count),
               VULKAN_BUFFERS(&r->seen, &r->rank, &r->splat_c, &r->row_key[0], &r->row_value[0]));
    vulkan_sort(r, r->row_key, r->row_value, COUNT_VISIBLE, r->count, 32); /* 8 passes: they end where they began */
    vulkan_footprint(r, 0);
    vulkan_scan(r, &r->row_pairs, &r->row_pairs, r->count, COUNT_PAIRS);
    vulkan_download(v, &r->counts, COUNT_PAIRS * sizeof pairs, &pairs, sizeof pairs);
    r->pairs = pairs;
    if (pairs == UINT32_MAX && v->rc == OXL_OK)
        v->rc = oxl_fail(v->ctx, OXL_ERR_MEMORY,
                         "more (tile, splat) pairs in one view than can be numbered\nfix: a smaller --max-side");
}

static void vulkan_order_pairs(struct vulkan_renderer *r)
{
    struct vulkan *v    = r->v;
    uint32_t       bits = 1;
    while (r->tiles >> bits) bits++;
    for (int k = 0; k < 2; k++) {
        vulkan_reserve(v, &r->pair_key[k], r->pairs, 4, "(tile, splat) pairs");
        vulkan_reserve(v, &r->pair_value[k], r->pairs, 4, "(tile, splat) pairs");
    }
    vulkan_reserve(v, &r->staged, r->pairs, 8, "(tile, splat) pairs");
    vulkan_reserve(v, &r->histogram, 16 * vulkan_blocks(r->pairs), 4, "(tile, splat) pairs");
    vulkan_reserve(v, &r->scan_sums, vulkan_blocks(16 * vulkan_blocks(r->pairs)), 4, "(tile, splat) pairs");
    vulkan_footprint(r, 1);
    r->sort_end = vulkan_sort(r, r->pair_key, r->pair_value, COUNT_PAIRS, r->pairs, bits);
    VULKAN_RUN(v, RANGES, 0, vulkan_groups(r->tiles + 1), VULKAN_PUSH((uint32_t)r->pairs, (uint32_t)r->tiles),
               VULKAN_BUFFERS(&r->pair_key[r->sort_end], &r->start));
}

static void vulkan_draw(struct vulkan_renderer *r, int depths)
{
    VULKAN_RUN(r->v, RASTER, r->lobes ? 1 : 0, r->tiles, VULKAN_PUSH((uint32_t)r->lobes, (uint32_t)depths),
               VULKAN_BUFFERS(&r->view_buffer, &r->start, &r->pair_value[r->sort_end], &r->staged, &r->splat_a, &r->splat_b,
                              &r->splat_c, &r->lobe_a, &r->rgb));
}

static oxl_result vulkan_forward(void *device, const oxl_model *model, const oxl_camera *camera,
                                 const oxl_render_options *options)
{
    struct vulkan_renderer *r = device;
    if (r->stepped && (r->model != model || r->plane != model->plane[0])) {
        const oxl_result rc = vulkan_fetch(device); /* another model is drawn in between */
        if (rc != OXL_OK) return rc;
    }
    vulkan_enter(r->v);
    vulkan_take_model(r, model);
    r->bands = options->sh_degree < 0 || options->sh_degree > model->sh_degree ? model->sh_degree : options->sh_degree;
    vulkan_take_view(r, camera, options);
    vulkan_order_rows(r);
    vulkan_order_pairs(r);
    vulkan_draw(r, 0);
    return r->v->rc;
}

static oxl_result vulkan_image(void *device, int depths, float *rgb)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    if (depths) vulkan_draw(r, 1);
    vulkan_download(r->v, &r->rgb, 0, rgb, 12 * (size_t)r->view.width * r->view.height);
    return r->v->rc;
}

/* ---------------------------------------------------------------- loss */

static void vulkan_compare(struct vulkan_renderer *r, float ssim_weight, int masked)
{
    struct vulkan *v       = r->v;
    uint32_t       push[6] = {r->view.width, r->view.height, 0, (uint32_t)r->tiles, vulkan_bits(ssim_weight), (uint32_t)masked};
    for (push[2] = 0; push[2] < 3; push[2]++)
        VULKAN_RUN(v, LOSS_FORWARD, 0, r->tiles, push,
                   VULKAN_BUFFERS(&r->rgb, &r->target, &r->weight, &r->slope[push[2]], &r->partial));
    VULKAN_RUN(v, LOSS_TOTAL, 0, 1, VULKAN_PUSH(3 * (uint32_t)r->tiles), VULKAN_BUFFERS(&r->partial, &r->totals));
    for (push[2] = 0; push[2] < 3; push[2]++)
        VULKAN_RUN(v, LOSS_BACKWARD, 0, r->tiles, push,
                   VULKAN_BUFFERS(&r->rgb, &r->target, &r->weight, &r->slope[push[2]], &r->totals, &r->drgb));
}

static int vulkan_has_photo(const void *device, int view)
{
    const struct vulkan_renderer *r = device;
    return (size_t)view < r->photo_capacity && r->photo[view].bytes.handle;
}

static void vulkan_send_photo(struct vulkan *v, const struct photo *photo, struct vulkan_photo *to)
{
    const size_t pixels = (size_t)photo->width * (size_t)photo->height;
    to->width           = (uint32_t)photo->width;
    to->height          = (uint32_t)photo->height;
    to->mask_at         = photo->mask ? (uint32_t)((3 * pixels + 3) / 4 * 4) : 0;
    vulkan_reserve(v, &to->bytes, 4 * pixels + 4, 1, "bytes of a photograph");
    vulkan_upload(v, &to->bytes, 0, photo->rgb, 3 * pixels);
    if (photo->mask) vulkan_upload(v, &to->bytes, to->mask_at, photo->mask, pixels);
}

/* A place to keep a photograph of so many bytes, or NULL: those that came first stay, the others pass through. */
static struct vulkan_photo *vulkan_photo_place(struct vulkan_renderer *r, int view, size_t bytes)
{
    const size_t wanted = (size_t)view + 1, more = wanted + wanted / 2;
    if (r->photo_bytes + bytes > r->v->photos || r->photos >= r->v->properties.limits.maxMemoryAllocationCount / 2) return NULL;
    if (wanted > r->photo_capacity) {
        struct vulkan_photo *grown = oxl_regrow(r->v->ctx, r->photo, r->photo_capacity, more, sizeof *grown);
        if (!grown) return NULL;
        memset(grown + r->photo_capacity, 0, (more - r->photo_capacity) * sizeof *grown);
        r->photo          = grown;
        r->photo_capacity = more;
    }
    r->photo_bytes += bytes;
    r->photos++; /* each is an allocation, and a device may allow but 4096 */
    return &r->photo[view];
}

static oxl_result vulkan_take_photo(void *device, int view, const struct photo *photo, int halved)
{
    struct vulkan_renderer *r       = device;
    struct vulkan          *v       = r->v;
    struct vulkan_photo     passing = {.bytes = r->passing}, *p = vulkan_has_photo(r, view) ? &r->photo[view] : NULL;
    size_t                  pixels;
    vulkan_enter(v);
    if (!p) {
        p = vulkan_photo_place(r, view, 4 * (size_t)photo->width * (size_t)photo->height);
        if (!p) p = &passing;
        vulkan_send_photo(v, photo, p);
        if (p == &passing) r->passing = passing.bytes;
    }
    pixels    = (size_t)(p->width >> halved) * (size_t)(p->height >> halved);
    r->masked = p->mask_at > 0;
    vulkan_reserve(v, &r->target, pixels, 12, "pixels");
    if (r->masked) vulkan_reserve(v, &r->weight, pixels, 4, "pixels");
    VULKAN_RUN(v, UNPACK, 0, vulkan_groups(pixels),
               VULKAN_PUSH(p->width, p->height, (uint32_t)halved, (uint32_t)r->masked, p->mask_at),
               VULKAN_BUFFERS(&p->bytes, &r->target, &r->weight));
    return v->rc;
}

static oxl_result vulkan_loss(void *device, const float *rgb, const float *weight, float ssim_weight, struct renderer_loss *out)
{
    struct vulkan_renderer *r      = device;
    struct vulkan          *v      = r->v;
    const size_t            pixels = (size_t)r->view.width * r->view.height;
    float                   total[5];
    vulkan_enter(v);
    if (rgb) vulkan_reserve(v, &r->target, pixels, 12, "pixels");
    vulkan_reserve(v, &r->drgb, pixels, 12, "pixels");
    vulkan_reserve(v, &r->partial, 15 * r->tiles, 4, "tiles");
    for (int ch = 0; ch < 3 && ssim_weight > 0; ch++) vulkan_reserve(v, &r->slope[ch], pixels, 12, "pixels");
    if (weight) vulkan_reserve(v, &r->weight, pixels, 4, "pixels");
    if (rgb) vulkan_upload(v, &r->target, 0, rgb, 12 * pixels);
    if (weight) vulkan_upload(v, &r->weight, 0, weight, 4 * pixels);
    vulkan_compare(r, ssim_weight, rgb ? weight != NULL : r->masked);
    vulkan_download(v, &r->totals, 0, total, sizeof total);
    if (v->rc != OXL_OK) return v->rc;
    out->l1    = total[3] > 0 ? (double)total[0] / total[3] : 0;
    out->ssim  = total[4] > 0 ? ssim_weight > 0 ? (double)total[1] / total[4] : 0 : 1;
    out->mse   = total[3] > 0 ? (double)total[2] / total[3] : 0;
    out->total = (1 - (double)ssim_weight) * out->l1 + (double)ssim_weight * (1 - out->ssim);
    return OXL_OK;
}

/* ---------------------------------------------------------------- backward and score */

static void vulkan_draw_backward(struct vulkan_renderer *r, uint32_t score)
{
    struct vulkan *v = r->v;
    vulkan_reserve(v, &r->sums_a, r->pairs, 16, "(tile, splat) pairs");
    if (!score) vulkan_reserve(v, &r->sums_b, r->pairs, 16, "(tile, splat) pairs");
    if (!score) vulkan_reserve(v, &r->sums_c, r->pairs, 4, "(tile, splat) pairs");
    if (!score && r->lobes) vulkan_reserve(v, &r->sums_d, r->pairs, 16, "(tile, splat) pairs");
    if (!score && r->lobes) vulkan_reserve(v, &r->sums_e, r->pairs, 8, "(tile, splat) pairs");
    VULKAN_RUN(v, RASTER_BACKWARD, (r->lobes ? 1 : 0) + 2 * score, r->tiles, VULKAN_PUSH((uint32_t)r->lobes),
               VULKAN_BUFFERS(&r->view_buffer, &r->start, &r->pair_value[r->sort_end], &r->staged, &r->splat_a, &r->splat_b,
                              &r->splat_c, &r->lobe_a, &r->rgb, &r->drgb, &r->sums_a, &r->sums_b, &r->sums_c, &r->sums_d,
                              &r->sums_e));
}

static void vulkan_take_drgb(struct vulkan_renderer *r, const float *drgb)
{
    const size_t pixels = (size_t)r->view.width * r->view.height;
    vulkan_reserve(r->v, &r->drgb, pixels, 12, "pixels");
    vulkan_upload(r->v, &r->drgb, 0, drgb, 12 * pixels);
}

static oxl_result vulkan_backward(void *device, const float *drgb)
{
    struct vulkan_renderer *r = device;
    uint32_t                push[6];
    vulkan_enter(r->v);
    if (drgb) vulkan_take_drgb(r, drgb);
    vulkan_draw_backward(r, 0);
    vulkan_reserve(r->v, &r->mean2d, r->count, 4, "Gaussians");
    for (size_t s = 0; s < r->slabs; s++) {
        vulkan_reserve(r->v, &r->slab[s].gradient, (size_t)r->stride * r->planes, sizeof(float), "numbers of Gaussians");
        vulkan_row_push(r, s, push);
        VULKAN_RUN(r->v, PROJECT_BACKWARD, 0, vulkan_groups(push[1]), push,
                   VULKAN_BUFFERS(&r->view_buffer, &r->slab[s].parameter, &r->seen, &r->row_slots, &r->sums_a, &r->sums_b,
                                  &r->sums_c, &r->sums_d, &r->sums_e, &r->slab[s].gradient, &r->mean2d));
    }
    return r->v->rc;
}

/* Rows that were not seen have none: the device leaves theirs as they were. */
static void vulkan_fetch_plane(struct vulkan_renderer *r, size_t slab, uint32_t plane, const uint32_t *seen, float *out)
{
    const size_t rows = vulkan_slab_rows(r, slab, plane < r->lobe_plane ? r->count : r->lobes), first = slab * r->stride;
    const int    past = plane < r->lobe_plane && plane >= (uint32_t)(OXL_SH + 3 * (r->bands + 1) * (r->bands + 1));
    if (rows == 0 || past) return;
    vulkan_download(r->v, &r->slab[slab].gradient, (size_t)plane * r->stride * sizeof(float), out + first, rows * sizeof(float));
    for (size_t i = first; i < first + rows && r->v->rc == OXL_OK; i++)
        if (!seen[i]) out[i] = 0;
}

static oxl_result vulkan_gradient(void *device, oxl_model *gradient)
{
    struct vulkan_renderer *r    = device;
    uint32_t               *seen = oxl_alloc(r->v->ctx, r->count + 1, sizeof *seen);
    if (!seen) return oxl_fail(r->v->ctx, OXL_ERR_MEMORY, "no memory for a gradient");
    vulkan_enter(r->v);
    vulkan_download(r->v, &r->seen, 0, seen, r->count * sizeof *seen);
    for (size_t s = 0; s < r->slabs; s++)
        for (uint32_t k = 0; k < r->planes; k++) vulkan_fetch_plane(r, s, k, seen, vulkan_host_plane(gradient, r, k));
    oxl_free(r->v->ctx, seen);
    return r->v->rc;
}

static oxl_result vulkan_score(void *device, const float *drgb, float *score)
{
    struct vulkan_renderer *r   = device;
    struct vulkan          *v   = r->v;
    float                  *one = oxl_alloc(v->ctx, r->count + 1, sizeof *one);
    if (!one) return oxl_fail(v->ctx, OXL_ERR_MEMORY, "no memory for the scores of %zu Gaussians", r->count);
    vulkan_enter(v);
    vulkan_take_drgb(r, drgb);
    vulkan_draw_backward(r, 1);
    vulkan_reserve(v, &r->score, r->count, 4, "Gaussians");
    VULKAN_RUN(v, SCORE, 0, vulkan_groups(r->count), VULKAN_PUSH((uint32_t)r->count),
               VULKAN_BUFFERS(&r->seen, &r->row_slots, &r->sums_a, &r->score));
    vulkan_download(v, &r->score, 0, one, r->count * sizeof *one);
    for (size_t i = 0; v->rc == OXL_OK && i < r->count; i++) score[i] += one[i];
    oxl_free(v->ctx, one);
    return v->rc;
}

/* ---------------------------------------------------------------- step and statistics */

static oxl_result vulkan_step(void *device, oxl_model *model, oxl_model *first, oxl_model *second,
                              const struct renderer_pace *pace, struct renderer_aside *out)
{
    struct vulkan_renderer *r          = device;
    struct vulkan          *v          = r->v;
    const double            correction = 1 - vecmath_exp(pace->step * vecmath_log(pace->beta[0]));
    const float             inverse    = (float)(1 / sqrt(1 - vecmath_exp(pace->step * vecmath_log(pace->beta[1]))));
    const uint32_t          planes     = (uint32_t)(OXL_SH + 3 * (r->bands + 1) * (r->bands + 1));
    float                   rate[OXL_PLANES];
    uint32_t                aside[2] = {0, UINT32_MAX}, push[6];
    vulkan_enter(v);
    for (uint32_t k = 0; k < r->planes; k++)
        rate[k] = (float)(pace->rate[k < r->lobe_plane ? k : OXL_LOBE + k - r->lobe_plane] / correction);
    if (r->model != model) v->rc = oxl_fail(v->ctx, OXL_ERR_USAGE, "a step of another model than the one that was drawn");
    vulkan_take_moments(r, first, second);
    vulkan_update(v, &r->rates, 0, rate, r->planes * sizeof *rate);
    vulkan_update(v, &r->counts, COUNT_ASIDE * sizeof *aside, aside, sizeof aside);
    for (size_t s = 0; s < r->slabs; s++) {
        vulkan_row_push(r, s, push);
        VULKAN_RUN(v, ADAM, 0, vulkan_groups(push[1]),
                   VULKAN_PUSH(push[0], push[1], push[2], planes, push[4], push[5], COUNT_ASIDE,
                               vulkan_bits((float)pace->beta[0]), vulkan_bits((float)pace->beta[1]), vulkan_bits(inverse)),
                   VULKAN_BUFFERS(&r->slab[s].parameter, &r->slab[s].gradient, &r->slab[s].first, &r->slab[s].second, &r->seen,
                                  &r->counts, &r->rates));
    }
    r->stepped = 1;
    vulkan_download(v, &r->counts, COUNT_ASIDE * sizeof *aside, aside, sizeof aside);
    *out = (struct renderer_aside){aside[0], aside[0] ? aside[1] : SIZE_MAX};
    return v->rc;
}

static oxl_result vulkan_observe(void *device, const struct renderer_sums *sums)
{
    struct vulkan_renderer *r      = device;
    struct vulkan          *v      = r->v;
    const float             z_near = sums->banded ? sums->z_near : FLT_MAX, z_far = sums->banded ? sums->z_far : FLT_MAX;
    vulkan_enter(v);
    r->sums = *sums;
    vulkan_reserve(v, &r->statistics, r->count, 16, "Gaussians");
    if (!r->observed) vulkan_copy_sums(r, 1);
    r->observed = v->rc == OXL_OK;
    VULKAN_RUN(v, OBSERVE, 0, vulkan_groups(r->count), VULKAN_PUSH((uint32_t)r->count, vulkan_bits(z_near), vulkan_bits(z_far)),
               VULKAN_BUFFERS(&r->seen, &r->mean2d, &r->splat_c, &r->statistics));
    return v->rc;
}

static oxl_result vulkan_forget(void *device)
{
    struct vulkan_renderer *r = device;
    vulkan_enter(r->v);
    vulkan_fill(r->v, &r->seen, 0);
    return r->v->rc;
}

/* ---------------------------------------------------------------- what the last view saw, for the host */

static oxl_result vulkan_rows(void *device, struct splat *splat, uint16_t *visible, float *mean2d)
{
    struct vulkan_renderer *r = device;
    struct vulkan          *v = r->v;
    const size_t            n = r->count;
    float(*a)[4]              = oxl_alloc(v->ctx, 3 * n + 1, sizeof *a);
    uint32_t *seen            = oxl_alloc(v->ctx, n + 1, sizeof *seen);
    v->rc                     = a && seen ? OXL_OK : oxl_fail(v->ctx, OXL_ERR_MEMORY, "no memory to look at %zu Gaussians", n);
    if (v->rc == OXL_OK) {
        vulkan_download(v, &r->splat_a, 0, a, n * sizeof *a);
        vulkan_download(v, &r->splat_b, 0, a + n, n * sizeof *a);
        vulkan_download(v, &r->splat_c, 0, a + 2 * n, n * sizeof *a);
        vulkan_download(v, &r->seen, 0, seen, n * sizeof *seen);
        if (r->mean2d.size >= n * sizeof *mean2d) vulkan_download(v, &r->mean2d, 0, mean2d, n * sizeof *mean2d);
    }
    memset(visible, 0, (n + PACK - 1) / PACK * sizeof *visible);
    for (size_t i = 0; i < n && v->rc == OXL_OK; i++) {
        const float *b = a[n + i], *c = a[2 * n + i];
        if (!seen[i]) continue;
        visible[i / PACK] = (uint16_t)(visible[i / PACK] | 1u << i % PACK);
        splat[i]          = (struct splat){.u      = a[i][0],
                                           .v      = a[i][1],
                                           .a      = a[i][2],
                                           .k      = a[i][3],
                                           .e      = b[0],
                                           .peak   = b[1],
                                           .colour = {c[0], c[1], c[2]},
                                           .depth  = c[3],
                                           .half_x = b[2],
                                           .half_y = b[3]};
    }
    oxl_free(v->ctx, a);
    oxl_free(v->ctx, seen);
    return v->rc;
}

OXL_INTERNAL const struct renderer_device *vulkan_doors(void)
{
    static const struct renderer_device doors = {.create     = vulkan_renderer_create,
                                                 .free       = vulkan_renderer_free,
                                                 .forward    = vulkan_forward,
                                                 .image      = vulkan_image,
                                                 .has_photo  = vulkan_has_photo,
                                                 .take_photo = vulkan_take_photo,
                                                 .loss       = vulkan_loss,
                                                 .backward   = vulkan_backward,
                                                 .gradient   = vulkan_gradient,
                                                 .score      = vulkan_score,
                                                 .step       = vulkan_step,
                                                 .observe    = vulkan_observe,
                                                 .fetch      = vulkan_fetch,
                                                 .forget     = vulkan_forget,
                                                 .rows       = vulkan_rows};
    return &doors;
}
