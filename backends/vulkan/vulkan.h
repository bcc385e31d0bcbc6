/* vulkan.h - the interface of the optional Vulkan backend. */
#ifndef OXL_VULKAN_H
#define OXL_VULKAN_H

#include "../../src/render/device.h"

struct vulkan; /* an open device; its renderers refer to it */

/* device: its number in the list, or -1: the best that can be opened, each that cannot is said. any: a device
 * that is a CPU will do. One that is named always does. */
OXL_INTERNAL oxl_result vulkan_open(oxl_context *ctx, int device, int any, struct vulkan **out);
OXL_INTERNAL void vulkan_close(struct vulkan *v);                          /* NULL is fine */
OXL_INTERNAL const char *vulkan_name(const struct vulkan *v, int and_cpu); /* and_cpu: "NAME and cpu" */
OXL_INTERNAL const struct renderer_device *vulkan_functions(void);
OXL_INTERNAL oxl_result vulkan_list(oxl_context *ctx, struct text *out); /* a line a device */

#endif
