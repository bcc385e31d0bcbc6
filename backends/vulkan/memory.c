/* memory.c - buffers on the device, and how much memory there is for them.
 *
 * Where an allocation would exceed the memory budgets, or fails, of every kind of memory that is near, images
 * that are kept on the device make room (vulkan.evict); then kinds that are far, and those beyond their
 * budgets. What still fails is OXL_ERR_MEMORY, and with
 * --backend auto the CPU takes over (src/render/renderer.c).
 */
#include "state.h"

/* Free bytes of the heap that memory of this kind lies in: as the driver says, or all that it has. A budget
 * is at most the heap: an RADV once gave 2^64 less a little. */
static size_t vulkan_memory_free(const struct vulkan *v, uint32_t kind)
{
    VkPhysicalDeviceMemoryBudgetPropertiesEXT budget = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MEMORY_BUDGET_PROPERTIES_EXT};
    VkPhysicalDeviceMemoryProperties2 all = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MEMORY_PROPERTIES_2,
                                             .pNext = &budget};
    const uint32_t heap = v->memory.memoryTypes[kind].heapIndex;
    const VkDeviceSize size = v->memory.memoryHeaps[heap].size;
    if (!v->budgets) return (size_t)size;
    v->GetPhysicalDeviceMemoryProperties2KHR(v->physical, &all);
    budget.heapBudget[heap] = OXL_MIN(budget.heapBudget[heap], size);
    if (budget.heapBudget[heap] <= budget.heapUsage[heap]) return 0;
    return (size_t)(budget.heapBudget[heap] - budget.heapUsage[heap]);
}

/* The same within --device-ram. */
OXL_INTERNAL size_t vulkan_memory_left(const struct vulkan *v, uint32_t kind)
{
    const size_t free = vulkan_memory_free(v, kind), limit = v->ctx->options.device_ram;
    return limit ? OXL_MIN(free, limit - OXL_MIN(limit, v->allocated)) : free;
}

/* The first `close_by` are as good as the first one: of a discrete GPU its own; of others, which share the
 * host's memory, all. */
struct vulkan_kinds {
    uint32_t kind[VK_MAX_MEMORY_TYPES], count, close_by;
};

/* The kinds of memory with all that is needed, those that are also `preferred` first. None with a property
 * that is not named here: others, as AMD's coherent memory, want a feature. */
static struct vulkan_kinds vulkan_memory_kinds(const struct vulkan *v, uint32_t allowed,
                                               VkMemoryPropertyFlags needed, VkMemoryPropertyFlags preferred)
{
    const VkMemoryPropertyFlags known =
        VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT | VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT |
        VK_MEMORY_PROPERTY_HOST_COHERENT_BIT | VK_MEMORY_PROPERTY_HOST_CACHED_BIT;
    const int apart = v->properties.deviceType == VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU;
    struct vulkan_kinds out = {.count = 0};
    for (int strict = 1; strict >= 0; strict--) {
        for (uint32_t i = 0; i < v->memory.memoryTypeCount; i++) {
            const VkMemoryPropertyFlags has = v->memory.memoryTypes[i].propertyFlags;
            if (!(allowed >> i & 1) || (has & needed) != needed || (has & ~known)) continue;
            if (((has & preferred) == preferred) == strict) out.kind[out.count++] = i;
        }
        if (out.close_by == 0 || !apart) out.close_by = out.count;
    }
    return out;
}

static VkDeviceSize vulkan_heap_size(const struct vulkan *v, uint32_t kind)
{
    return v->memory.memoryHeaps[v->memory.memoryTypes[kind].heapIndex].size;
}

/* The one of the largest heap, as near to the device as the first is. */
static uint32_t vulkan_main_kind(const struct vulkan *v, const struct vulkan_kinds *from)
{
    uint32_t best = from->kind[0];
    for (uint32_t i = 1; i < from->count; i++) {
        const VkMemoryPropertyFlags other =
            v->memory.memoryTypes[from->kind[i]].propertyFlags ^ v->memory.memoryTypes[best].propertyFlags;
        if (other & VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT) continue;
        if (vulkan_heap_size(v, from->kind[i]) > vulkan_heap_size(v, best)) best = from->kind[i];
    }
    return best;
}

OXL_INTERNAL void vulkan_release(struct vulkan *v, struct vulkan_buffer *b)
{
    if (b->handle && !v->lost) v->DestroyBuffer(v->device, b->handle, NULL);
    if (b->memory && !v->lost) v->FreeMemory(v->device, b->memory, NULL);
    v->allocated -= b->counted;
    *b = (struct vulkan_buffer){0};
}

/* Once: drivers move what is too much to the host's memory, back and forth. */
static void vulkan_say_beyond(struct vulkan *v, VkDeviceSize size)
{
    if (!v->said_beyond)
        oxl_log(v->ctx, OXL_LOG_WARNING,
                "%s: %zu MiB more are beyond the memory that is left: slow, if other memory is used",
                v->properties.deviceName, (size_t)(size >> 20));
    v->said_beyond = 1;
}

/* A driver would move other memory off the device. */
static int vulkan_is_beyond(const struct vulkan *v, uint32_t kind, VkDeviceSize size)
{
    const int own = (v->memory.memoryTypes[kind].propertyFlags & VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT) != 0;
    return own && v->budgets && size > vulkan_memory_left(v, kind);
}

/* Of the first of `count` kinds that has room for it. A heap may be small (16 MiB of what the host sees,
 * before gigabytes), and more than a heap must not be asked of it. beyond: what its budget has not may be
 * asked of it. */
static VkResult vulkan_allocate_of(struct vulkan *v, VkDeviceSize size, const struct vulkan_kinds *from,
                                   uint32_t count, int beyond, VkDeviceMemory *out)
{
    VkMemoryAllocateInfo info = {.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, .allocationSize = size};
    VkResult result = VK_ERROR_OUT_OF_DEVICE_MEMORY;
    for (uint32_t i = 0; i < count && result == VK_ERROR_OUT_OF_DEVICE_MEMORY; i++) {
        info.memoryTypeIndex = from->kind[i];
        if (vulkan_heap_size(v, from->kind[i]) < size) continue;
        if (vulkan_is_beyond(v, from->kind[i], size)) {
            if (!beyond) continue;
            vulkan_say_beyond(v, size);
        }
        result = v->AllocateMemory(v->device, &info, NULL, out);
    }
    return result;
}

/* Allocates memory near the device, within --device-ram; own: bytes that count for it. */
static VkResult vulkan_allocate_near(struct vulkan *v, VkDeviceSize size, const struct vulkan_kinds *from,
                                     size_t own, VkDeviceMemory *out)
{
    const size_t limit = v->ctx->options.device_ram;
    if (limit && own > limit - OXL_MIN(limit, v->allocated)) return VK_ERROR_OUT_OF_DEVICE_MEMORY;
    return vulkan_allocate_of(v, size, from, from->close_by, 0, out);
}

/* Images that are kept on the device leave it before memory far from it is used, not while there is other
 * memory near it. */
static VkResult vulkan_allocate(struct vulkan *v, VkDeviceSize size, const struct vulkan_kinds *from,
                                size_t own, VkDeviceMemory *out)
{
    VkResult result = vulkan_allocate_near(v, size, from, own, out);
    if (vulkan_is_short(result) && v->evict && v->evict(v, 0) > 0)
        result = vulkan_allocate_near(v, size, from, own, out);
    if (v->lost) return v->lost; /* while images were waited for */
    return result == VK_ERROR_OUT_OF_DEVICE_MEMORY && !(own && v->ctx->options.device_ram)
               ? vulkan_allocate_of(v, size, from, from->count, !v->portable, out)
               : result;
}

OXL_INTERNAL void vulkan_create(struct vulkan *v, struct vulkan_buffer *b, size_t size, int for_host)
{
    const VkBufferCreateInfo info = {.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO,
                                     .size = size,
                                     .usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT |
                                              VK_BUFFER_USAGE_TRANSFER_SRC_BIT |
                                              VK_BUFFER_USAGE_TRANSFER_DST_BIT};
    const VkMemoryPropertyFlags host =
        VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    const size_t own = for_host ? 0 : size;
    VkMemoryRequirements needs;
    struct vulkan_kinds kinds;
    if (v->rc != OXL_OK ||
        !VULKAN_MADE(v, v->CreateBuffer(v->device, &info, NULL, &b->handle), b->handle, "a buffer"))
        return;
    v->GetBufferMemoryRequirements(v->device, b->handle, &needs);
    kinds = vulkan_memory_kinds(v, needs.memoryTypeBits, for_host ? host : 0,
                                for_host ? VK_MEMORY_PROPERTY_HOST_CACHED_BIT
                                         : VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
    if (!for_host && kinds.count > 0) v->kind = vulkan_main_kind(v, &kinds);
    if (kinds.count == 0) vulkan_ok(v, VK_ERROR_FEATURE_NOT_PRESENT, "memory that the host can see");
    else if (VULKAN_MADE(v, vulkan_allocate(v, needs.size, &kinds, own, &b->memory), b->memory,
                         "memory for a buffer"))
        vulkan_ok(v, v->BindBufferMemory(v->device, b->handle, b->memory, 0), "memory for a buffer");
    if (v->rc == OXL_OK) {
        b->size = size;
        b->counted = own;
        v->allocated += own;
        v->most_allocated = OXL_MAX(v->most_allocated, v->allocated);
    } else vulkan_release(v, b);
}

/* At least so many elements, and no more; what it held is lost. */
OXL_INTERNAL void vulkan_reserve_exactly(struct vulkan *v, struct vulkan_buffer *b, size_t count,
                                         size_t element, const char *what)
{
    const size_t least = OXL_MAX(count, (size_t)1) * element;
    if (v->rc != OXL_OK || b->size >= least) return;
    if (least > v->range || count > SIZE_MAX / element) {
        v->rc = oxl_fail(v->ctx, OXL_ERR_MEMORY,
                         "%s: %zu %s need %zu MiB in one array, %zu MiB is the most here\nfix: a smaller "
                         "--max-side, fewer --max-gaussians, or --backend cpu",
                         v->properties.deviceName, count, what, least >> 20, v->range >> 20);
        return;
    }
    if (b->handle && vulkan_finish(v) != OXL_OK) return; /* commands under way may name it */
    vulkan_release(v, b);
    vulkan_create(v, b, OXL_MAX(least, (size_t)256), 0);
}

/* With a quarter more where it is allocated, for what grows, if there is room for that. */
OXL_INTERNAL void vulkan_reserve(struct vulkan *v, struct vulkan_buffer *b, size_t count, size_t element,
                                 const char *what)
{
    const size_t more = OXL_MIN(count + count / 4, v->range / element);
    if (v->rc != OXL_OK || b->size >= OXL_MAX(count, (size_t)1) * element) return;
    vulkan_reserve_exactly(v, b, OXL_MAX(count, more), element, what);
    if (more > count && vulkan_may_retry(v)) vulkan_reserve_exactly(v, b, count, element, what);
}
