/* device.c - the choice of a device, its frames; opening and closing.
 */
#include "state.h"

/* ---------------- devices */

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
    case VK_PHYSICAL_DEVICE_TYPE_CPU: return "a CPU";
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
    struct vulkan v = {.ctx = ctx};
    VkPhysicalDevice device[VULKAN_DEVICES];
    uint32_t count = 0;
    if (vulkan_start(&v) == OXL_OK) {
        count = vulkan_devices(&v, device);
        if (count == 0) v.rc = oxl_fail(ctx, OXL_ERR_FAILED, "Vulkan finds no device here");
    } else v.rc = ctx->failed;
    for (uint32_t i = 0; i < count; i++) {
        VkPhysicalDeviceProperties p;
        v.GetPhysicalDeviceProperties(device[i], &p);
        text_add(out, "%u  %s (%s), Vulkan %u.%u.%u, arrays of %u MiB at most\n", i, p.deviceName,
                 vulkan_kind(p.deviceType), VK_VERSION_MAJOR(p.apiVersion), VK_VERSION_MINOR(p.apiVersion),
                 VK_VERSION_PATCH(p.apiVersion), p.limits.maxStorageBufferRange >> 20);
    }
    vulkan_stop(&v);
    return v.rc;
}

/* Whether it has what the passes ask for; most of it is what Vulkan 1.0 promises of any device, the bindings
 * are not. */
static int vulkan_fits(const VkPhysicalDeviceLimits *l)
{
    return l->maxPerStageDescriptorStorageBuffers >= VULKAN_BINDINGS &&
           l->maxComputeWorkGroupInvocations >= VULKAN_GROUP &&
           l->maxComputeWorkGroupSize[0] >= VULKAN_GROUP &&
           l->maxComputeSharedMemorySize >= vulkan_shared() &&
           l->maxStorageBufferRange >= sizeof(float) * OXL_PLANES * VULKAN_GROUP;
}

/* The device of this number, or (wanted -1) the best that was not tried, by bits. None is left: the last
 * one's error stays. */
static oxl_result vulkan_choose(struct vulkan *v, int wanted, int any, uint32_t *tried)
{
    VkPhysicalDevice device[VULKAN_DEVICES];
    const uint32_t count = vulkan_devices(v, device);
    int best = -1;
    uint32_t at = 0;
    if (count == 0)
        return oxl_fail(v->ctx, OXL_ERR_FAILED, "Vulkan finds no device here\nfix: --backend cpu");
    if (wanted >= (int)count)
        return oxl_fail(v->ctx, OXL_ERR_USAGE,
                        "device %d of %u\nfix: oceanxl info --devices has the list, from 0", wanted, count);
    for (uint32_t i = 0; i < count; i++) {
        VkPhysicalDeviceProperties p;
        int rank;
        v->GetPhysicalDeviceProperties(device[i], &p);
        rank = vulkan_rank(p.deviceType) + (vulkan_fits(&p.limits) ? 8 : 0);
        if ((*tried >> i & 1) || (wanted >= 0 ? (int)i != wanted : rank <= best)) continue;
        if (wanted < 0 && !any && p.deviceType == VK_PHYSICAL_DEVICE_TYPE_CPU) continue;
        best = rank;
        at = i;
        v->physical = device[i];
        v->properties = p;
    }
    if (best < 0 && *tried) return v->ctx->failed;
    if (best < 0) return oxl_fail(v->ctx, OXL_ERR_FAILED, "Vulkan finds no device here but the CPU");
    if (*tried)
        oxl_log(v->ctx, OXL_LOG_WARNING, "%.*s: trying %s", (int)strcspn(v->ctx->error, "\n"), v->ctx->error,
                v->properties.deviceName);
    *tried |= 1u << at;
    v->GetPhysicalDeviceMemoryProperties(v->physical, &v->memory);
    return OXL_OK;
}

/* No system resets a CPU, and a slow one may need minutes. Of GPUs the weakest discrete ones are hardly
 * faster than the others. */
static void vulkan_set_times(struct vulkan *v)
{
    const VkPhysicalDeviceType type = v->properties.deviceType;
    const int cpu = type == VK_PHYSICAL_DEVICE_TYPE_CPU;
    v->timeout_ns = cpu ? UINT64_MAX : VULKAN_WAIT;
    v->part = cpu ? 0 : type == VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU ? 4 * VULKAN_PART : VULKAN_PART;
}

static oxl_result vulkan_check(struct vulkan *v)
{
    const VkPhysicalDeviceLimits *l = &v->properties.limits;
    v->range = l->maxStorageBufferRange;
    v->groups_max = OXL_MIN(l->maxComputeWorkGroupCount[0], l->maxComputeWorkGroupCount[1]);
    vulkan_set_times(v);
    snprintf(v->name_and_cpu, sizeof v->name_and_cpu, "%s and cpu", v->properties.deviceName);
    v->slab_rows = (uint32_t)OXL_MIN(VULKAN_SLAB_ROWS,
                                     v->range / (sizeof(float) * OXL_PLANES) / VULKAN_GROUP * VULKAN_GROUP);
    if (vulkan_fits(l)) return OXL_OK;
    return oxl_fail(
        v->ctx, OXL_ERR_FAILED,
        "%s: %u storage buffers a shader, %u invocations a workgroup, %u bytes shared: expected %d, %u, %zu\nfix: another "
        "--device, or --backend cpu",
        v->properties.deviceName, l->maxPerStageDescriptorStorageBuffers, l->maxComputeWorkGroupInvocations,
        l->maxComputeSharedMemorySize, VULKAN_BINDINGS, VULKAN_GROUP, vulkan_shared());
}

/* A device that implements a part of Vulkan must be told that the part is known; the passes need none of what
 * it may lack. */
static void vulkan_device_extensions(struct vulkan *v, struct vulkan_extensions *e)
{
    e->count = VULKAN_LISTED;
    e->there = oxl_alloc(v->ctx, VULKAN_LISTED, sizeof *e->there);
    if (!e->there || v->EnumerateDeviceExtensionProperties(v->physical, NULL, &e->count, e->there) < 0)
        e->count = 0;
    v->portable = v->properties2 && vulkan_enable(e, "VK_KHR_portability_subset");
    v->budgets = v->properties2 && v->GetPhysicalDeviceMemoryProperties2KHR &&
                 vulkan_enable(e, VK_EXT_MEMORY_BUDGET_EXTENSION_NAME);
}

/* Fewer bits than 64 begin again at 0 from time to time. */
static uint64_t vulkan_stamp_mask(uint32_t bits)
{
    return bits < 64 ? ((uint64_t)1 << bits) - 1 : UINT64_MAX;
}

static oxl_result vulkan_create_device(struct vulkan *v)
{
    VkQueueFamilyProperties family[64];
    uint32_t count = OXL_COUNT(family);
    const float priority = 1;
    VkDeviceQueueCreateInfo queue = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO, .queueCount = 1, .pQueuePriorities = &priority};
    struct vulkan_extensions extensions = {0};
    VkDeviceCreateInfo info = {.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO,
                               .queueCreateInfoCount = 1,
                               .pQueueCreateInfos = &queue,
                               .ppEnabledExtensionNames = extensions.name};
    v->GetPhysicalDeviceQueueFamilyProperties(v->physical, &count, family);
    while (v->family < count && !(family[v->family].queueFlags & VK_QUEUE_COMPUTE_BIT)) v->family++;
    if (v->family == count)
        return oxl_fail(v->ctx, OXL_ERR_FAILED, "%s cannot compute\nfix: --backend cpu",
                        v->properties.deviceName);
    v->stamp_mask = vulkan_stamp_mask(family[v->family].timestampValidBits);
    queue.queueFamilyIndex = v->family;
    vulkan_device_extensions(v, &extensions);
    info.enabledExtensionCount = extensions.enabled;
    VULKAN_MADE(v, v->CreateDevice(v->physical, &info, NULL, &v->device), v->device, "a device");
    oxl_free(v->ctx, extensions.there);
    if (v->rc != OXL_OK) return v->rc;
#define VULKAN_FIND(name) v->name = (PFN_vk##name)v->GetDeviceProcAddr(v->device, "vk" #name);
    VULKAN_OF_DEVICE(VULKAN_FIND)
#undef VULKAN_FIND
    return OXL_OK;
}

static oxl_result vulkan_create_frame(struct vulkan *v, struct vulkan_frame *f)
{
    const VkCommandPoolCreateInfo pool = {.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO,
                                          .queueFamilyIndex = v->family};
    VkCommandBufferAllocateInfo commands = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
                                            .level = VK_COMMAND_BUFFER_LEVEL_PRIMARY,
                                            .commandBufferCount = VULKAN_COMMANDS};
    const VkFenceCreateInfo fence = {.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO};
    const VkDescriptorPoolSize size = {VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, VULKAN_SETS * VULKAN_BINDINGS};
    const VkDescriptorPoolCreateInfo sets = {.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO,
                                             .maxSets = VULKAN_SETS,
                                             .poolSizeCount = 1,
                                             .pPoolSizes = &size};
    if (!VULKAN_MADE(v, v->CreateCommandPool(v->device, &pool, NULL, &f->command_pool), f->command_pool,
                     "a command pool"))
        return v->rc;
    commands.commandPool = f->command_pool;
    if (vulkan_ok(v, v->AllocateCommandBuffers(v->device, &commands, f->command), "a command buffer") &&
        VULKAN_MADE(v, v->CreateFence(v->device, &fence, NULL, &f->fence), f->fence, "a fence"))
        VULKAN_MADE(v, v->CreateDescriptorPool(v->device, &sets, NULL, &f->descriptor_pool),
                    f->descriptor_pool, "descriptors");
    return v->rc;
}

/* ---------------- opening and closing */

/* The one that was chosen. */
static oxl_result vulkan_open_device(struct vulkan *v)
{
    void *mapped = NULL;
    oxl_result rc = vulkan_check(v);
    if (rc == OXL_OK) rc = vulkan_create_device(v);
    if (rc == OXL_OK) v->GetDeviceQueue(v->device, v->family, 0, &v->queue);
    for (int k = 0; k < VULKAN_FRAMES && rc == OXL_OK; k++) rc = vulkan_create_frame(v, &v->frame[k]);
    if (rc != OXL_OK) return rc;
    vulkan_create(v, &v->staging, VULKAN_MARKS + VULKAN_FRAMES * sizeof(uint32_t), 1);
    vulkan_create(v, &v->dummy, 256, 0);
    if (v->rc == OXL_OK)
        vulkan_ok(v, v->MapMemory(v->device, v->staging.memory, 0, VK_WHOLE_SIZE, 0, &mapped), "staging");
    v->mapped = mapped;
    v->image_bytes_max = vulkan_memory_left(v, v->kind) / VULKAN_IMAGE_SHARE;
    return v->rc;
}

/* Another may be opened then. */
static void vulkan_close_device(struct vulkan *v)
{
    if (v->device && v->DestroyDevice) {
        for (int pass = 0; pass < PASS_COUNT; pass++) {
            struct vulkan_pipeline *p = &v->pipeline[pass];
            for (int i = 0; i < VULKAN_VARIANTS; i++) v->DestroyPipeline(v->device, p->variant[i], NULL);
            v->DestroyPipelineLayout(v->device, p->layout, NULL);
            v->DestroyDescriptorSetLayout(v->device, p->set, NULL);
        }
        vulkan_release(v, &v->staging);
        vulkan_release(v, &v->dummy);
        v->DestroyQueryPool(v->device, v->clock, NULL);
        for (int k = 0; k < VULKAN_FRAMES; k++) {
            v->DestroyDescriptorPool(v->device, v->frame[k].descriptor_pool, NULL);
            v->DestroyFence(v->device, v->frame[k].fence, NULL);
            v->DestroyCommandPool(v->device, v->frame[k].command_pool, NULL);
        }
        v->DestroyDevice(v->device, NULL);
    }
    memset((char *)v + offsetof(struct vulkan, physical), 0, sizeof *v - offsetof(struct vulkan, physical));
}

/* The best that can be opened; to one that is named there is no other. */
static oxl_result vulkan_open_best(struct vulkan *v, int wanted, int any)
{
    uint32_t tried = 0;
    oxl_result rc = vulkan_choose(v, wanted, any, &tried);
    while (rc == OXL_OK) {
        rc = vulkan_open_device(v);
        if (rc == OXL_OK) return rc;
        vulkan_close_device(v);
        rc = vulkan_choose(v, wanted, any, &tried);
    }
    return rc;
}

OXL_INTERNAL oxl_result vulkan_open(oxl_context *ctx, int device, int any, struct vulkan **out)
{
    struct vulkan *v = oxl_calloc(ctx, 1, sizeof *v);
    oxl_result rc;
    *out = NULL;
    if (!v) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the Vulkan backend");
    v->ctx = ctx;
    rc = vulkan_start(v);
    if (rc == OXL_OK) rc = vulkan_open_best(v, device, any);
    if (rc == OXL_OK) *out = v;
    else vulkan_close(v);
    return rc;
}

OXL_INTERNAL void vulkan_close(struct vulkan *v)
{
    if (!v) return;
    vulkan_finish(v);
    if (v->lost) vulkan_stop_listening(v); /* may neither be waited for nor destroyed: vulkan_give_up */
    else {
        vulkan_close_device(v);
        vulkan_stop(v);
    }
    oxl_free(v->ctx, v);
}

OXL_INTERNAL const char *vulkan_name(const struct vulkan *v, int and_cpu)
{
    return and_cpu ? v->name_and_cpu : v->properties.deviceName;
}
