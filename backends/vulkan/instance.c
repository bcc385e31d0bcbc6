/* instance.c - the Vulkan loader, opened at run time, an instance with its extensions, the validation layer.
 *
 * Built by make VULKAN=1 alone; needs the headers to compile, and nothing at run time: a machine without a
 * loader or a device says so in one line.
 */
#include "state.h"

/* Homebrew's folder is none that macOS searches. */
static const char *const VULKAN_LIBRARY[] = {"libvulkan.so.1",
                                             "libvulkan.so",
                                             "vulkan-1.dll",
                                             "libvulkan.dylib",
                                             "libvulkan.1.dylib",
                                             "libMoltenVK.dylib",
                                             "/opt/homebrew/lib/libvulkan.dylib",
                                             "/opt/homebrew/lib/libvulkan.1.dylib",
                                             "/opt/homebrew/lib/libMoltenVK.dylib"};

static int vulkan_load(struct vulkan *v)
{
    const char *named =
        getenv("OXL_VULKAN_LIBRARY"); /* another loader; a name that is not there: a machine without one */
    for (size_t i = 0; !named && !v->library && i < OXL_COUNT(VULKAN_LIBRARY); i++)
        v->library = os_library_open(VULKAN_LIBRARY[i]);
    if (named) v->library = os_library_open(named);
    if (!v->library) return 0;
    os_library_symbol(v->library, "vkGetInstanceProcAddr", &v->GetInstanceProcAddr,
                      sizeof v->GetInstanceProcAddr);
    if (!v->GetInstanceProcAddr) return 0;
#define VULKAN_FIND(name) v->name = (PFN_vk##name)v->GetInstanceProcAddr(NULL, "vk" #name);
    VULKAN_OF_LOADER(VULKAN_FIND)
#undef VULKAN_FIND
    return v->CreateInstance != NULL;
}

static VKAPI_ATTR VkBool32 VKAPI_CALL vulkan_log_validation(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
                                                            VkDebugUtilsMessageTypeFlagsEXT types,
                                                            const VkDebugUtilsMessengerCallbackDataEXT *data,
                                                            void *user)
{
    struct vulkan *v = user;
    (void)severity, (void)types;
    if (v->validation_messages++ < 10)
        oxl_log(v->ctx, OXL_LOG_WARNING, "Vulkan validation: %s", data->pMessage);
    return VK_FALSE;
}

static const char *const VULKAN_VALIDATION = "VK_LAYER_KHRONOS_validation";

/* The validation layer is for developers of this file: OXL_VULKAN_VALIDATE=1, and the layer installed. */
static int vulkan_validates(struct vulkan *v)
{
    const char *mode = getenv("OXL_VULKAN_VALIDATE");
    VkLayerProperties layer[64];
    uint32_t count = OXL_COUNT(layer);
    if (!mode || strcmp(mode, "0") == 0 || !v->EnumerateInstanceLayerProperties) return 0;
    if (v->EnumerateInstanceLayerProperties(&count, layer) < 0) return 0;
    for (uint32_t i = 0; i < count; i++)
        if (strcmp(layer[i].layerName, VULKAN_VALIDATION) == 0) return 1;
    return 0;
}

OXL_INTERNAL int vulkan_enable(struct vulkan_extensions *e, const char *name)
{
    for (uint32_t i = 0; i < e->count; i++)
        if (strcmp(e->there[i].extensionName, name) == 0) {
            e->name[e->enabled++] = name;
            return 1;
        }
    return 0;
}

/* A portability driver (MoltenVK on Apple's) is listed only for programs that declare support for its limits.
 * */
static VkInstanceCreateFlags vulkan_instance_extensions(struct vulkan *v, struct vulkan_extensions *e)
{
    e->count = VULKAN_LISTED;
    e->there = oxl_alloc(v->ctx, VULKAN_LISTED, sizeof *e->there);
    if (!e->there || !v->EnumerateInstanceExtensionProperties ||
        v->EnumerateInstanceExtensionProperties(NULL, &e->count, e->there) < 0)
        e->count = 0;
    v->properties2 = vulkan_enable(e, VK_KHR_GET_PHYSICAL_DEVICE_PROPERTIES_2_EXTENSION_NAME);
    if (!v->properties2 || !vulkan_enable(e, VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME)) return 0;
    return VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR;
}

/* Chained to the instance, the layer checks from the first call on, and synchronization too;
 * OXL_VULKAN_VALIDATE=gpu: also what shaders read and write, past the end of a buffer. */
static VkResult vulkan_make_instance(struct vulkan *v, const VkDebugUtilsMessengerCreateInfoEXT *listen)
{
    const char *mode = getenv("OXL_VULKAN_VALIDATE");
    const int gpu = v->validates && mode && strcmp(mode, "gpu") == 0;
    const VkValidationFeatureEnableEXT more[2] = {
        VK_VALIDATION_FEATURE_ENABLE_GPU_ASSISTED_EXT,
        VK_VALIDATION_FEATURE_ENABLE_GPU_ASSISTED_RESERVE_BINDING_SLOT_EXT};
    const VkValidationFeatureEnableEXT sync = VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT;
    const VkValidationFeaturesEXT features = {.sType = VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT,
                                              .pNext = listen,
                                              .enabledValidationFeatureCount = gpu ? 2u : 1u,
                                              .pEnabledValidationFeatures = gpu ? more : &sync};
    const VkApplicationInfo application = {.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO,
                                           .pApplicationName = "oceanxl",
                                           .apiVersion = gpu ? VK_API_VERSION_1_1 : VK_API_VERSION_1_0};
    struct vulkan_extensions extensions = {0};
    VkInstanceCreateInfo info = {.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
                                 .pNext = v->validates ? &features : NULL,
                                 .flags = vulkan_instance_extensions(v, &extensions),
                                 .pApplicationInfo = &application,
                                 .enabledLayerCount = v->validates ? 1u : 0u,
                                 .ppEnabledLayerNames = &VULKAN_VALIDATION,
                                 .ppEnabledExtensionNames = extensions.name};
    VkResult result;
    /* the layer's own */
    if (v->validates) extensions.name[extensions.enabled++] = VK_EXT_DEBUG_UTILS_EXTENSION_NAME;
    info.enabledExtensionCount = extensions.enabled;
    result = v->CreateInstance(&info, NULL, &v->instance);
    oxl_free(v->ctx, extensions.there);
    return result;
}

OXL_INTERNAL oxl_result vulkan_start(struct vulkan *v)
{
    const VkDebugUtilsMessengerCreateInfoEXT listen = {
        .sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT,
        .messageSeverity =
            VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT,
        .messageType =
            VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT,
        .pfnUserCallback = vulkan_log_validation,
        .pUserData = v};
    PFN_vkCreateDebugUtilsMessengerEXT create;
    if (!vulkan_load(v))
        return oxl_fail(
            v->ctx, OXL_ERR_FAILED,
            "no Vulkan loader (libvulkan.so.1) on this machine\nfix: install a driver, or --backend cpu");
    v->validates = vulkan_validates(v);
    if (!VULKAN_MADE(v, vulkan_make_instance(v, &listen), v->instance, "the loader")) return v->rc;
#define VULKAN_FIND(name) v->name = (PFN_vk##name)v->GetInstanceProcAddr(v->instance, "vk" #name);
    VULKAN_OF_INSTANCE(VULKAN_FIND)
#undef VULKAN_FIND
    if (!v->validates) return OXL_OK;
    create = (PFN_vkCreateDebugUtilsMessengerEXT)v->GetInstanceProcAddr(v->instance,
                                                                        "vkCreateDebugUtilsMessengerEXT");
    if (create)
        VULKAN_MADE(v, create(v->instance, &listen, NULL, &v->messenger), v->messenger,
                    "the validation layer");
    return v->rc;
}

OXL_INTERNAL void vulkan_stop_listening(struct vulkan *v)
{
    PFN_vkDestroyDebugUtilsMessengerEXT destroy;
    if (!v->messenger) return;
    destroy = (PFN_vkDestroyDebugUtilsMessengerEXT)v->GetInstanceProcAddr(v->instance,
                                                                          "vkDestroyDebugUtilsMessengerEXT");
    if (destroy) destroy(v->instance, v->messenger, NULL);
}

OXL_INTERNAL void vulkan_stop(struct vulkan *v)
{
    vulkan_stop_listening(v);
    if (v->instance) v->DestroyInstance(v->instance, NULL);
    if (v->library) os_library_close(v->library);
}
