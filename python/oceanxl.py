"""oceanxl - 3D Gaussian Splatting of underwater surveys: the library of oceanxl.h, by ctypes and numpy.

    import oceanxl as oxl
    scene = oxl.load("survey", max_side=320)
    model = oxl.train(scene, preset="draft", iterations=500)
    image, depth, alpha = oxl.render(model, scene.views[3])
    print(oxl.metrics(image, scene.views[3].image), oxl.evaluate(model, scene)["psnr"])
    model.save("model.ply")

Images are (H,W,3) float arrays, 0 black and 1 white. Arrays of scenes, images and models are views of the library's memory, which they
keep alive: nothing is copied, and what is written to model.means, .scales, .quats, .opacities or .sh is in the model. Parameters are raw,
as gsplat's: log scale, logit opacity, quaternion w x y z. Options have the names and the meaning of oceanxl.h, with words for its enums.
All functions of oceanxl.h are in `lib`; Context.call raises Error for those that fail. `make python` builds the library.
"""
import json
import os
import pathlib
import signal
import sys
import threading
import time
import weakref
from collections import namedtuple
from ctypes import (CDLL, CFUNCTYPE, POINTER, Array, Structure, addressof, byref, c_char_p, c_double, c_float, c_int, c_size_t, c_uint8,
                    c_uint64, c_void_p, cast, pointer)

import numpy as np


def _open():
    here, name = pathlib.Path(__file__).resolve().parent, "liboceanxl.so"
    given = os.environ.get("OXL_LIBRARY")
    places = [pathlib.Path(given)] if given else [here / name, here.parent / "build" / name]
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # OpenMP reads it when it is loaded: threads that wait must not spin
    for place in places:
        if place.exists():
            return CDLL(str(place))
    raise ImportError(f"there is no {' and no '.join(map(str, places))}\nfix: make python, in OceanXL's folder")


lib = _open()


# ---- generated from oceanxl.h by generate.py: do not edit
globals().update({'OXL_OK': 0, 'OXL_ERR_FAILED': 1, 'OXL_ERR_USAGE': 2, 'OXL_ERR_INPUT': 3, 'OXL_ERR_IO': 4, 'OXL_ERR_MEMORY': 5,
    'OXL_ERR_BUDGET': 6, 'OXL_ERR_INTERRUPTED': 7, 'OXL_LOG_ERROR': 0, 'OXL_LOG_WARNING': 1, 'OXL_LOG_INFO': 2, 'OXL_LOG_DEBUG': 3,
    'OXL_BACKEND_CPU': 0, 'OXL_BACKEND_AUTO': 1, 'OXL_BACKEND_VULKAN': 2, 'OXL_ALPHA_AUTO': 0, 'OXL_ALPHA_COMPOSITE': 1, 'OXL_ALPHA_MASK':
    2, 'OXL_MEAN': 0, 'OXL_LOG_SCALE': 3, 'OXL_ROTATION': 6, 'OXL_OPACITY': 10, 'OXL_SH': 11, 'OXL_LOBE': 59, 'OXL_PLANES': 63,
    'OXL_SPLIT_TEST': 0, 'OXL_SPLIT_TRAIN': 1, 'OXL_SPLIT_ALL': 2, 'OXL_DOG_OFF': 0, 'OXL_DOG_SELECTIVE': 1, 'OXL_DOG_ALL': 2, 'OXL_OFF': 0,
    'OXL_ON': 1, 'OXL_AUTO': 2, 'OXL_PRESET_DRAFT': 0, 'OXL_PRESET_STANDARD': 1, 'OXL_PRESET_PAPER': 2, 'OXL_KEEP_ALL': 0,
    'OXL_KEEP_FRACTION': 1, 'OXL_KEEP_COUNT': 2, 'OXL_KEEP_BYTES': 3, 'OXL_UCD_OFF': 0, 'OXL_UCD_ON': 1, 'OXL_UCD_AUTO': 2,
    'OXL_UCD_SEARCH': 3, 'OXL_REMOVE': 0, 'OXL_KEEP': 1, 'OXL_SPLIT': 2, 'OXL_STAGE_BLOCK': 0, 'OXL_STAGE_COARSE': 1, 'OXL_STAGE_MERGED': 2,
    'OXL_VERSION': '0.1.0', 'OXL_STRUCTURE_NONE': 0.5})
WORDS = {'oxl_result': {'ok': 0, 'err_failed': 1, 'err_usage': 2, 'err_input': 3, 'err_io': 4, 'err_memory': 5, 'err_budget': 6,
    'err_interrupted': 7}, 'oxl_log_level': {'error': 0, 'warning': 1, 'info': 2, 'debug': 3}, 'oxl_backend': {'cpu': 0, 'auto': 1,
    'vulkan': 2}, 'oxl_alpha': {'auto': 0, 'composite': 1, 'mask': 2}, 'oxl_split': {'test': 0, 'train': 1, 'all': 2}, 'oxl_dog': {'off': 0,
    'selective': 1, 'all': 2}, 'oxl_switch': {'off': 0, 'on': 1, 'auto': 2}, 'oxl_preset': {'draft': 0, 'standard': 1, 'paper': 2},
    'oxl_keep_kind': {'all': 0, 'fraction': 1, 'count': 2, 'bytes': 3}, 'oxl_ucd': {'off': 0, 'on': 1, 'auto': 2, 'search': 3},
    'oxl_change': {'remove': 0, 'keep': 1, 'split': 2}, 'oxl_stage': {'block': 0, 'coarse': 1, 'merged': 2}}
CHOICES = {'oxl_context_options.backend': 'oxl_backend', 'oxl_scene_options.alpha': 'oxl_alpha', 'oxl_keep.kind': 'oxl_keep_kind',
    'oxl_train_options.ucd': 'oxl_ucd', 'oxl_train_options.exposure': 'oxl_switch', 'oxl_train_options.lamp': 'oxl_switch',
    'oxl_train_options.medium': 'oxl_switch', 'oxl_train_options.poses': 'oxl_switch', 'oxl_train_options.dog': 'oxl_dog',
    'oxl_progress.stage': 'oxl_stage'}
globals().update((name, type(name, (Structure,), {})) for name in ('oxl_context_options', 'oxl_image', 'oxl_camera', 'oxl_view',
    'oxl_point', 'oxl_scene_options', 'oxl_model', 'oxl_render_options', 'oxl_view_metrics', 'oxl_metrics', 'oxl_keep', 'oxl_terms',
    'oxl_train_options', 'oxl_nonfinite', 'oxl_progress', 'oxl_callback', 'oxl_trained', 'oxl_adam'))
oxl_context_options._fields_ = [("threads", c_int), ("seed", c_uint64), ("reallocate", CFUNCTYPE(c_void_p, c_void_p, c_void_p, c_size_t)),
    ("log", CFUNCTYPE(None, c_void_p, c_int, c_char_p)), ("stopped", CFUNCTYPE(c_int, c_void_p)), ("user", c_void_p), ("backend", c_int),
    ("device", c_int), ("device_ram", c_size_t), ("command_line", c_int)]
oxl_image._fields_ = [("width", c_int), ("height", c_int), ("rgb", POINTER(c_float)), ("weight", POINTER(c_float))]
oxl_camera._fields_ = [("width", c_int), ("height", c_int), ("fx", c_double), ("fy", c_double), ("cx", c_double), ("cy", c_double),
    ("rotation", c_double * 9), ("translation", c_double * 3)]
oxl_view._fields_ = [("name", c_char_p), ("camera", oxl_camera), ("is_test", c_int)]
oxl_point._fields_ = [("position", c_double * 3), ("error", c_float), ("rgb", c_uint8 * 3)]
oxl_scene_options._fields_ = [("images", c_char_p), ("sparse", c_char_p), ("masks", c_char_p), ("auto_mask", c_int), ("alpha", c_int),
    ("max_side", c_int), ("test_every", c_int), ("image_cache_bytes", c_size_t), ("missing_images", c_double), ("read_images", c_int),
    ("allow_truncated", c_int)]
oxl_model._fields_ = [("count", c_size_t), ("capacity", c_size_t), ("lobes", c_size_t), ("sh_degree", c_int), ("origin", c_double * 3),
    ("scale", c_double), ("plane", POINTER(c_float) * OXL_PLANES), ("memory", c_void_p), ("background", c_float * 3), ("has_background",
    c_int), ("antialias", c_int), ("view", c_double * 13), ("not_finite", c_size_t)]
oxl_render_options._fields_ = [("background", c_float * 3), ("sh_degree", c_int), ("near_plane", c_float), ("alpha_min", c_float),
    ("parallel", c_float)]
oxl_view_metrics._fields_ = [("view", c_int), ("psnr", c_double), ("cc_psnr", c_double), ("ssim", c_double), ("plain_psnr", c_double),
    ("aligned_psnr", c_double), ("aligned_ssim", c_double), ("structure", c_double), ("unshown", c_double * 4), ("shown_psnr", c_double)]
oxl_metrics._fields_ = [("psnr", c_double), ("cc_psnr", c_double), ("ssim", c_double), ("plain_psnr", c_double), ("aligned_psnr", c_double),
    ("aligned_ssim", c_double), ("structure", c_double), ("structure_least", c_double), ("unshown", c_double), ("shown_psnr", c_double),
    ("no_structure", c_int), ("count", c_int), ("views", POINTER(oxl_view_metrics))]
oxl_keep._fields_ = [("kind", c_int), ("value", c_double)]
oxl_terms._fields_ = [("pixels", CFUNCTYPE(c_double, c_void_p, POINTER(oxl_image), POINTER(oxl_image), POINTER(c_float))), ("parameters",
    CFUNCTYPE(c_double, c_void_p, POINTER(oxl_model), POINTER(oxl_model))), ("density", CFUNCTYPE(None, c_void_p, POINTER(oxl_model),
    POINTER(c_float), POINTER(c_float), POINTER(c_uint8))), ("user", c_void_p)]
oxl_train_options._fields_ = [("iterations", c_int), ("sh_degree", c_int), ("max_gaussians", c_int), ("max_seconds", c_double),
    ("background", c_float * 3), ("ssim_weight", c_float), ("coarse", c_float), ("dropout", c_float), ("alpha_min", c_float),
    ("lr_position", c_float), ("lr_position_final", c_float), ("lr_scale", c_float), ("lr_rotation", c_float), ("lr_sh0", c_float),
    ("lr_sh", c_float), ("short_run_exponent", c_float), ("cooldown", c_float), ("densify_until", c_float), ("densify_every", c_int),
    ("densify_gradient", c_float), ("ucd", c_int), ("keep", oxl_keep), ("exposure", c_int), ("lamp", c_int), ("medium", c_int), ("poses",
    c_int), ("antialias", c_int), ("stereo", c_int), ("dog", c_int), ("terms", POINTER(oxl_terms)), ("from", POINTER(oxl_model)),
    ("survey_iterations", c_int), ("experimental", c_float * 4)]
oxl_nonfinite._fields_ = [("images", c_size_t), ("steps", c_size_t), ("rows", c_size_t), ("cleared", c_size_t)]
oxl_progress._fields_ = [("iteration", c_int), ("iterations", c_int), ("block", c_int), ("blocks", c_int), ("stage", c_int), ("gaussians",
    c_size_t), ("loss", c_double), ("psnr", c_double), ("seconds", c_double), ("seconds_left", c_double), ("memory", c_size_t), ("model",
    POINTER(oxl_model)), ("nonfinite", oxl_nonfinite)]
oxl_callback._fields_ = [("progress", CFUNCTYPE(c_int, c_void_p, POINTER(oxl_progress))), ("user", c_void_p)]
oxl_trained._fields_ = [("model", oxl_model), ("imaging", c_void_p), ("viewer", oxl_model), ("decisions", c_char_p), ("iterations", c_int),
    ("finished", c_int), ("seconds", c_double), ("nonfinite", oxl_nonfinite)]
oxl_adam._fields_ = [("rate", c_float * OXL_PLANES), ("beta", c_double * 2), ("step", c_int)]
FUNCTIONS = {"oxl_context_options_default": [oxl_context_options], "oxl_context_create": [c_int, POINTER(oxl_context_options),
    POINTER(c_void_p)], "oxl_context_free": [None, c_void_p], "oxl_error_text": [c_char_p, c_void_p], "oxl_text_free": [None, c_void_p,
    c_char_p], "oxl_isa_name": [c_char_p, c_void_p], "oxl_backend_begin": [c_int, c_void_p], "oxl_backend_name": [c_char_p, c_void_p],
    "oxl_devices": [c_int, c_void_p, POINTER(c_char_p)], "oxl_image_create": [c_int, c_void_p, c_int, c_int, POINTER(oxl_image)],
    "oxl_image_free": [None, c_void_p, POINTER(oxl_image)], "oxl_image_read": [c_int, c_void_p, c_char_p, POINTER(oxl_image)],
    "oxl_image_write": [c_int, c_void_p, c_char_p, POINTER(oxl_image)], "oxl_image_write_alpha": [c_int, c_void_p, c_char_p,
    POINTER(oxl_image)], "oxl_image_to_jpeg": [c_int, c_void_p, POINTER(oxl_image), c_int, POINTER(c_char_p), POINTER(c_size_t)],
    "oxl_scene_options_default": [oxl_scene_options], "oxl_scene_load": [c_int, c_void_p, c_char_p, POINTER(oxl_scene_options),
    POINTER(c_void_p)], "oxl_scene_from_arrays": [c_int, c_void_p, POINTER(oxl_view), POINTER(oxl_image), c_int, POINTER(oxl_point),
    c_size_t, POINTER(c_void_p)], "oxl_scene_free": [None, c_void_p, c_void_p], "oxl_scene_view_count": [c_int, c_void_p], "oxl_scene_view":
    [POINTER(oxl_view), c_void_p, c_int], "oxl_scene_point_count": [c_size_t, c_void_p], "oxl_scene_points": [POINTER(oxl_point), c_void_p],
    "oxl_scene_origin": [POINTER(c_double), c_void_p], "oxl_scene_near_plane": [c_double, c_void_p], "oxl_scene_reference":
    [POINTER(c_double), c_void_p], "oxl_scene_extent": [c_double, c_void_p], "oxl_scene_ray": [c_int, c_void_p, c_void_p, c_int, c_double,
    c_double, POINTER(c_double), POINTER(c_double)], "oxl_scene_image": [c_int, c_void_p, c_void_p, c_int, POINTER(c_float),
    POINTER(oxl_image)], "oxl_imaging_read": [c_int, c_void_p, c_char_p, c_void_p, POINTER(c_void_p)], "oxl_imaging_write": [c_int,
    c_void_p, c_char_p, c_void_p, c_void_p], "oxl_imaging_gain": [None, c_void_p, c_int, POINTER(c_float)], "oxl_imaging_free": [None,
    c_void_p, c_void_p], "oxl_model_create": [c_int, c_void_p, c_size_t, c_int, POINTER(oxl_model)], "oxl_model_free": [None, c_void_p,
    POINTER(oxl_model)], "oxl_model_planes": [c_int, POINTER(oxl_model)], "oxl_model_move_origin": [None, POINTER(oxl_model),
    POINTER(c_double)], "oxl_model_rescale": [None, POINTER(oxl_model), c_double], "oxl_model_from_points": [c_int, c_void_p,
    POINTER(oxl_point), c_size_t, c_int, POINTER(oxl_model)], "oxl_model_read": [c_int, c_void_p, c_char_p, POINTER(oxl_model)],
    "oxl_model_write": [c_int, c_void_p, c_char_p, POINTER(oxl_model)], "oxl_render_options_default": [oxl_render_options], "oxl_render":
    [c_int, c_void_p, POINTER(oxl_model), POINTER(oxl_camera), POINTER(oxl_render_options), POINTER(oxl_image), POINTER(c_float)],
    "oxl_render_view": [c_int, c_void_p, POINTER(oxl_model), c_void_p, c_int, c_void_p, POINTER(oxl_image), POINTER(c_float)],
    "oxl_render_backward": [c_int, c_void_p, POINTER(oxl_model), POINTER(oxl_camera), POINTER(oxl_render_options), POINTER(c_float),
    POINTER(oxl_model)], "oxl_psnr": [c_int, c_void_p, POINTER(oxl_image), POINTER(oxl_image), POINTER(c_double)], "oxl_cc_psnr": [c_int,
    c_void_p, POINTER(oxl_image), POINTER(oxl_image), POINTER(c_double)], "oxl_ssim": [c_int, c_void_p, POINTER(oxl_image),
    POINTER(oxl_image), POINTER(c_double)], "oxl_structure": [c_int, c_void_p, POINTER(oxl_image), POINTER(oxl_image), POINTER(c_double)],
    "oxl_evaluate": [c_int, c_void_p, POINTER(oxl_model), c_void_p, c_void_p, c_int, POINTER(oxl_metrics)], "oxl_metrics_free": [None,
    c_void_p, POINTER(oxl_metrics)], "oxl_train_options_default": [oxl_train_options, c_int], "oxl_train_options_check": [c_int, c_void_p,
    POINTER(oxl_train_options)], "oxl_train": [c_int, c_void_p, c_void_p, POINTER(oxl_train_options), POINTER(oxl_callback),
    POINTER(oxl_trained)], "oxl_trained_free": [None, c_void_p, POINTER(oxl_trained)], "oxl_trained_write": [c_int, c_void_p, c_char_p,
    c_void_p, POINTER(oxl_trained)], "oxl_adam_at": [oxl_adam, c_void_p, POINTER(oxl_train_options), c_int], "oxl_adam_step": [c_int,
    c_void_p, POINTER(oxl_model), POINTER(oxl_model), POINTER(oxl_model), POINTER(oxl_adam)]}
# ---- end of what is generated
for _name, (_result, *_arguments) in FUNCTIONS.items():
    getattr(lib, _name).restype, getattr(lib, _name).argtypes = _result, _arguments


# ---------------------------------------------------------------- contexts, memory, options

class Error(RuntimeError):
    """The library's text: what was found, what was expected, a fix; and `code`, one of OXL_ERR_*."""

    def __init__(self, code, text):
        super().__init__(text)
        self.code = code


class Context:
    """Threads, seed and log. Scenes and models keep the context that they were made with."""

    def __init__(self, threads=0, seed=1, log=None, **options):
        o = _fill(lib.oxl_context_options_default(), dict(options, threads=threads, seed=seed))
        log = log or (lambda level, text: level <= OXL_LOG_WARNING and print(f"oceanxl: {text}", file=sys.stderr))
        o.log = type(o.log)(lambda _user, level, text: log(level, text.decode(errors="replace")))
        self.lock, self.c = threading.RLock(), c_void_p()
        if lib.oxl_context_create(byref(o), byref(self.c)) != OXL_OK:
            raise Error(OXL_ERR_FAILED, lib.oxl_error_text(None).decode())
        weakref.finalize(self, lambda c, _log: lib.oxl_context_free(c), self.c, o.log)

    def call(self, function, *arguments, allowed=OXL_OK):
        with self.lock:  # a context is used by one thread at a time
            code = function(self.c, *arguments)
            if code not in (OXL_OK, allowed):
                raise Error(code, lib.oxl_error_text(self.c).decode(errors="replace"))
            return code


_first = []


def _context():
    if not _first:
        _first.append(Context())
    return _first[0]


class _Owned:
    """A C struct or pointer, released when neither a Python object nor an array refers to it."""

    def __init__(self, context, kind, free):
        self.context, self.c = context, kind()
        weakref.finalize(self, _Owned.release, context, free, self.c)

    @staticmethod
    def release(context, free, c):
        with context.lock:
            free(context.c, byref(c) if isinstance(c, Structure) else c)


def _array(owner, at, shape, kind=np.float32, strides=None):
    """An array on memory that `owner` keeps; `at` is a ctypes pointer."""
    dtype = np.dtype(kind)
    strides = strides or tuple(dtype.itemsize * int(np.prod(shape[i + 1:], dtype=int)) for i in range(len(shape)))
    if 0 in shape:
        return np.empty(shape, dtype)
    last = sum((n - 1) * s for n, s in zip(shape, strides)) + dtype.itemsize
    memory = (c_uint8 * last).from_address(cast(at, c_void_p).value)
    memory.owner = owner
    return np.ndarray(shape, dtype, memory, strides=strides)


def _word(key, value):
    words = WORDS[CHOICES.get(key, key)]
    if not isinstance(value, str):
        return int(value)
    if value not in words:
        raise ValueError(f"{key} is {value!r}, wanted one of {', '.join(words)}")
    return words[value]


def _fill(struct, values):
    """Sets fields of an options struct: words for enums, sequences for arrays, dictionaries for structs, text and paths for char *."""
    names = dict(struct._fields_)
    for name, value in values.items():
        if name not in names:
            raise TypeError(f"{type(struct).__name__} has no {name!r}, but {', '.join(names)}")
        now, key = getattr(struct, name), f"{type(struct).__name__}.{name}"
        if isinstance(now, Structure):
            _fill(now, value if isinstance(value, dict) else {now._fields_[0][0]: value})
        elif isinstance(now, Array):
            now[:] = value
        elif names[name] is c_char_p:
            setattr(struct, name, None if value is None else os.fsencode(value))
        else:
            setattr(struct, name, _word(key, value) if key in CHOICES else value)
    return struct


# ---------------------------------------------------------------- scenes and images

def _image_array(owned):
    """(H,W,3), in memory as the library has it: (3,H,W)."""
    image = owned.c
    return np.moveaxis(_array(owned, image.rgb, (3, image.height, image.width)), 0, -1)


def _planar(image):
    """(3,H,W) floats of an (H,W,3) image; a copy only where the memory is laid out in another way."""
    image = np.asarray(image, np.float32)
    if image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"an image has the shape {image.shape}, wanted (height, width, 3)")
    return np.ascontiguousarray(np.moveaxis(image, -1, 0))


def _floats(array):
    return array.ctypes.data_as(POINTER(c_float))


def _image(image, weight=None):
    rgb = _planar(image)
    out = oxl_image(rgb.shape[2], rgb.shape[1], _floats(rgb))
    weight = None if weight is None else np.ascontiguousarray(weight, np.float32)
    if weight is not None:
        out.weight = _floats(weight)
    out.kept = rgb, weight
    return out


class View:
    """An image of a scene and the camera that took it."""

    def __init__(self, scene, index):
        c = lib.oxl_scene_view(scene.c, index).contents
        self.scene, self.index, self.name = scene, index, os.fsdecode(c.name)
        self.camera, self.is_test = c.camera, bool(c.is_test)

    def read(self):
        """The image (H,W,3) and its weight (H,W), 0 where it is masked; None: no pixel is. Read anew at each call."""
        owned = _Owned(self.scene.context, oxl_image, lib.oxl_image_free)
        self.scene.context.call(lib.oxl_scene_image, self.scene.c, self.index, None, byref(owned.c))
        image = owned.c
        return _image_array(owned), _array(owned, image.weight, (image.height, image.width)) if image.weight else None

    image = property(lambda self: self.read()[0])
    weight = property(lambda self: self.read()[1])

    @property
    def pose(self):
        """(4,4) world to camera, as gsplat's viewmats, in the scene's local coordinates."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.reshape(self.camera.rotation, (3, 3)), self.camera.translation
        return pose

    @property
    def K(self):
        """(3,3) intrinsics, as gsplat's Ks."""
        c = self.camera
        return np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])


def camera(width, height, K, pose):
    """A camera to render from: size in px, (3,3) intrinsics, (4,4) world to camera."""
    K, pose = np.asarray(K, float), np.asarray(pose, float)
    return oxl_camera(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(pose[:3, :3].ravel()), tuple(pose[:3, 3]))


class Scene:
    """Views and points, relative to `origin`: world = local + origin."""

    def __init__(self, owned):
        self._owned, self.context, self.c = owned, owned.context, owned.c
        self.views = [View(self, i) for i in range(lib.oxl_scene_view_count(self.c))]
        self.training = [v for v in self.views if not v.is_test]
        self.origin = np.array(lib.oxl_scene_origin(self.c)[:3])
        self.extent, self.near_plane = lib.oxl_scene_extent(self.c), lib.oxl_scene_near_plane(self.c)

    @property
    def points(self):
        """(N) records of position, error and rgb."""
        kind = np.dtype([("position", "f8", 3), ("error", "f4"), ("rgb", "u1", 3)], align=True)
        return _array(self._owned, lib.oxl_scene_points(self.c), (lib.oxl_scene_point_count(self.c),), kind)


def load(path, context=None, **options):
    """Reads a survey. options: of oxl_scene_options, such as max_side=320."""
    context = context or _context()
    owned = _Owned(context, c_void_p, lib.oxl_scene_free)
    o = _fill(lib.oxl_scene_options_default(), options)
    context.call(lib.oxl_scene_load, os.fsencode(path), byref(o), byref(owned.c))
    return Scene(owned)


def write_image(path, image):
    """Writes an 8-bit PNG."""
    _context().call(lib.oxl_image_write, os.fsencode(path), byref(_image(image)))


# ---------------------------------------------------------------- models

def _parameter(first, number, text, shape=None):
    def read(self):
        planes = self._planes(first, number if number else 3 * (self.c.sh_degree + 1) ** 2)
        return shape(planes) if shape else planes.T

    def write(self, value):
        read(self)[...] = value
    return property(read, write, doc=text)


class Model:
    """Gaussians. len(model) is their number, model[rows] a copy of some."""

    means = _parameter(OXL_MEAN, 3, "(N,3) local coordinates")
    scales = _parameter(OXL_LOG_SCALE, 3, "(N,3) log of the standard deviations")
    quats = _parameter(OXL_ROTATION, 4, "(N,4) w x y z, of any length")
    opacities = _parameter(OXL_OPACITY, 1, "(N) logit", lambda planes: planes[0])
    sh = _parameter(OXL_SH, 0, "(N,K,3) spherical harmonics; colour = 0.5 + sum of basis x coefficient",
                    lambda planes: planes.reshape(-1, 3, planes.shape[1]).transpose(2, 0, 1))
    imaging = None  # what lies between the model's colours and the images: gains, lamp, medium, poses

    def __init__(self, owned, c=None):
        self._owned, self.context, self.c = owned, owned and owned.context, owned.c if c is None else c

    @classmethod
    def _made(cls, context, function, *arguments):
        owned = _Owned(context, oxl_model, lib.oxl_model_free)
        context.call(function, *arguments, byref(owned.c))
        return cls(owned)

    @classmethod
    def create(cls, count, sh_degree=0, context=None):
        """All values are 0, except rotations: the identity."""
        return cls._made(context or _context(), lib.oxl_model_create, count, sh_degree)

    @classmethod
    def from_points(cls, scene, sh_degree=0):
        """A round Gaussian for each of the scene's points [Kerbl 2023]."""
        model = cls._made(scene.context, lib.oxl_model_from_points, lib.oxl_scene_points(scene.c), len(scene.points), sh_degree)
        model.c.origin[:] = scene.origin
        return model

    @classmethod
    def read(cls, path, scene=None, context=None):
        """Reads .ply, .splat or .spz; with a scene also the imaging beside it, and the scene's origin is taken."""
        model = cls._made(scene.context if scene else context or _context(), lib.oxl_model_read, os.fsencode(path))
        if scene:
            imaging = _Owned(scene.context, c_void_p, lib.oxl_imaging_free)
            scene.context.call(lib.oxl_imaging_read, os.fsencode(path), scene.c, byref(imaging.c))
            model.imaging = imaging if imaging.c else None
            lib.oxl_model_move_origin(byref(model.c), lib.oxl_scene_origin(scene.c))
        return model

    def save(self, path):
        """Writes .ply, .splat or .spz."""
        self.context.call(lib.oxl_model_write, os.fsencode(path), byref(self.c))

    def _planes(self, first, number):
        m = self.c
        at = [cast(m.plane[first + k], c_void_p).value for k in range(min(number, 2))]
        return _array(self._owned, m.plane[first], (number, m.count), strides=(at[-1] - at[0] if m.count else 0, 4))

    def __len__(self):
        return self.c.count

    def __getitem__(self, rows):
        if self.c.lobes:
            raise ValueError(f"{self.c.lobes} of {len(self)} Gaussians have second lobes\nfix: train with dog=\"off\"")
        planes = self._planes(0, lib.oxl_model_planes(byref(self.c)))[:, rows]
        out = Model.create(planes.shape[1], self.c.sh_degree, self.context)
        out._planes(0, len(planes))[...] = planes
        for name in ("origin", "scale", "background", "has_background", "antialias", "view"):
            setattr(out.c, name, getattr(self.c, name))
        out.imaging = self.imaging
        return out

    sh_degree = property(lambda self: self.c.sh_degree)
    origin = property(lambda self: np.array(self.c.origin[:]))


class Trained(Model):
    """What training gives: the model, its imaging, and how it came about."""

    def __init__(self, owned, scene):
        super().__init__(owned, owned.c.model)
        self.scene = scene
        if owned.c.imaging:
            self.imaging = _Owned.__new__(_Owned)  # belongs to `owned`
            self.imaging.context, self.imaging.c, self.imaging.owner = owned.context, c_void_p(owned.c.imaging), owned
        self.iterations, self.finished, self.seconds = owned.c.iterations, bool(owned.c.finished), owned.c.seconds
        self.decisions = json.loads("{" + (owned.c.decisions or b"").decode() + "}")

    def write(self, folder):
        """Writes the files that `oceanxl train` writes: scene.ply and, where needed, scene_standard.ply, imaging.txt."""
        os.makedirs(folder, exist_ok=True)
        self.context.call(lib.oxl_trained_write, os.fsencode(folder), self.scene.c, byref(self._owned.c))


# ---------------------------------------------------------------- rendering and metrics

def _seen(model, view, background=None):
    """The camera and the options by which a view, or a camera, is rendered."""
    o = lib.oxl_render_options_default()
    o.background[:] = model.c.background if background is None else background
    if isinstance(view, View):
        o.near_plane = view.scene.near_plane
        return view.camera, o
    return view, o


def render_image(model, view, imaging=True, background=None, depth=None):
    """The image (H,W,3) of a view, or of a camera. imaging: as the view's image was taken, with the model's gains, lamp, medium and
    pose; False: the model's own colours, of which render_backward is the derivative."""
    owned = _Owned(model.context, oxl_image, lib.oxl_image_free)
    at, o = _seen(model, view, background)
    z = None if depth is None else _floats(depth)
    if isinstance(view, View) and imaging and model.imaging and background is None:
        model.context.call(lib.oxl_render_view, byref(model.c), view.scene.c, view.index, model.imaging.c, byref(owned.c), z)
    else:
        model.context.call(lib.oxl_render, byref(model.c), byref(at), byref(o), byref(owned.c), z)
    return _image_array(owned)


Render = namedtuple("Render", "image depth alpha")


def render(model, view, imaging=True):
    """Image (H,W,3); depth (H,W), camera z of the surface, negative where it is doubtful, 0 where there is none; alpha (H,W). The last
    costs two more renders: render_image gives the image alone."""
    at, _ = _seen(model, view)
    depth = np.zeros((at.height, at.width), np.float32)
    image = render_image(model, view, imaging, depth=depth)
    black, white = (render_image(model, view, False, background=(g, g, g)) for g in (0, 1))
    return Render(image, depth, 1 - (white - black)[..., 0])


def render_backward(model, view, dimage):
    """A Model that holds the gradient of a loss in each parameter, from that in each pixel of render_image(model, view, False)."""
    at, o = _seen(model, view)
    drgb = _planar(dimage)
    if drgb.shape != (3, at.height, at.width):
        raise ValueError(f"the gradient of an image has the shape {np.shape(dimage)}, wanted {(at.height, at.width, 3)}")
    return Model._made(model.context, lib.oxl_render_backward, byref(model.c), byref(at), byref(o), _floats(drgb))


def metrics(image, reference, weight=None):
    """PSNR (dB), colour-corrected PSNR, SSIM and structure of an image against another; weight 0: pixels that do not count."""
    a, b, out, value = _image(image), _image(reference, weight), {}, c_double()
    for name in ("psnr", "cc_psnr", "ssim"):
        _context().call(getattr(lib, f"oxl_{name}"), byref(a), byref(b), byref(value))
        out[name] = value.value
    _context().call(lib.oxl_structure, byref(a), byref(b), byref(value))
    return dict(out, structure=value.value)


def evaluate(model, scene, split="test"):
    """Means over the views of a split, "test", "train" or "all", and `views`, a row each."""
    owned = _Owned(scene.context, oxl_metrics, lib.oxl_metrics_free)
    scene.context.call(lib.oxl_evaluate, byref(model.c), scene.c, model.imaging.c if model.imaging else None, _word("oxl_split", split),
                       byref(owned.c))

    def row(struct):
        return {n: getattr(struct, n) for n, _ in struct._fields_ if n != "views"}
    return dict(row(owned.c), views=[row(owned.c.views[i]) for i in range(owned.c.count)])


# ---------------------------------------------------------------- training

class _Run:
    """The callbacks of a run. What they raise is kept, stops the run, and is raised behind it."""

    def __init__(self, context, show, callback, pixels, parameters, density):
        self.context, self.show, self.callback = context, show, callback
        self.pixels, self.parameters, self.density = pixels, parameters, density
        self.raised, self.stopped, self.shown = None, False, 0
        self.c = oxl_callback(dict(oxl_callback._fields_)["progress"](self._guarded(self._progress)))
        self.terms = oxl_terms()
        for name in ("pixels", "parameters", "density"):
            if getattr(self, name):
                setattr(self.terms, name, dict(oxl_terms._fields_)[name](self._guarded(getattr(self, f"_{name}"))))

    def _guarded(self, function):
        def call(_user, *arguments):
            try:
                return function(*arguments) if self.raised is None else 1
            except BaseException as raised:
                self.raised = raised
                return 1
        return call

    def _model(self, m):
        model = Model(None, m.contents)
        model.context = self.context
        return model

    def _progress(self, progress):
        p = progress.contents
        if self.show and (time.monotonic() - self.shown > (0.2 if sys.stderr.isatty() else 10) or p.iteration == p.iterations):
            self.shown = time.monotonic()
            print(f"{p.iteration}/{p.iterations}  loss {p.loss:.4f}  PSNR {p.psnr:.2f} dB  {p.gaussians} Gaussians  "
                  f"{p.seconds_left:.0f} s left", end="   \r" if sys.stderr.isatty() else "\n", file=sys.stderr, flush=True)
        return bool((self.callback and self.callback(p)) or self.stopped)

    @staticmethod
    def _pixel_arrays(image):
        size = image.height, image.width
        return np.moveaxis(_array(None, image.rgb, (3, *size)), 0, -1), _array(None, image.weight, size) if image.weight else None

    def _pixels(self, rendered, image, drgb):
        x, _ = self._pixel_arrays(rendered.contents)
        y, weight = self._pixel_arrays(image.contents)
        value, gradient = self.pixels(x, y, weight)
        np.moveaxis(_array(None, drgb, (3, *x.shape[:2])), 0, -1)[...] += gradient
        return value

    def _parameters(self, model, gradient):
        return self.parameters(self._model(model), self._model(gradient))

    def _density(self, model, gradient, views, change):
        n = (model.contents.count,)
        self.density(self._model(model), _array(None, gradient, n), _array(None, views, n), _array(None, change, n, np.uint8))

    def __enter__(self):
        self.main = threading.current_thread() is threading.main_thread()
        if self.main:
            self.old = signal.signal(signal.SIGINT, lambda *_: setattr(self, "stopped", True))
        return self

    def __exit__(self, *_):
        if self.main:
            signal.signal(signal.SIGINT, self.old)
        if self.show and sys.stderr.isatty():
            print(file=sys.stderr)
        if self.raised is not None:
            raise self.raised


def _train_options(preset, start, options):
    o = _fill(lib.oxl_train_options_default(_word("oxl_preset", preset)), options)
    if start is not None:
        setattr(o, "from", pointer(start.c))
    return o


def train(scene, preset="draft", start=None, callback=None, pixels=None, parameters=None, density=None, progress=True, **options):
    """Trains as `oceanxl train` does one block; options: of oxl_train_options, such as iterations=500, exposure="off". Ctrl-C stops,
    and the model so far is returned, with .finished False.

    start         a model to begin with, instead of the scene's points
    callback(p)   after each step, p as oxl_progress; what is true stops the run
    pixels(rendered, image, weight) -> (value, gradient)    a term in the loss, and d/d rendered (H,W,3); weight None: no pixel is masked
    parameters(model, gradient) -> value    a term that adds to gradient.means, .scales and so on
    density(model, gradient, views, change) rewrites change: OXL_REMOVE, OXL_KEEP or OXL_SPLIT; gradient / views is the mean of |dL/d(u, v)|
    """
    o = _train_options(preset, start, options)
    owned = _Owned(scene.context, oxl_trained, lib.oxl_trained_free)
    with _Run(scene.context, progress, callback, pixels, parameters, density) as run:
        if pixels or parameters or density:
            o.terms = pointer(run.terms)
        scene.context.call(lib.oxl_train, scene.c, byref(o), byref(run.c), byref(owned.c), allowed=OXL_ERR_INTERRUPTED)
    return Trained(owned, scene)


class Adam:
    """Adam with the rates of a run of `iterations` steps, for a loop of one's own: adam.step(gradient) moves the model."""

    def __init__(self, model, scene, preset="draft", **options):
        self.model, self.scene, self.steps = model, scene, 0
        self.options = _train_options(preset, None, options)
        self.moments = (oxl_model * 2)()
        weakref.finalize(self, Adam.release, model.context, self.moments)

    @staticmethod
    def release(context, moments):
        for m in moments:
            _Owned.release(context, lib.oxl_model_free, m)

    def step(self, gradient):
        self.steps += 1
        adam = lib.oxl_adam_at(self.scene.c, byref(self.options), self.steps)
        self.model.context.call(lib.oxl_adam_step, byref(self.model.c), byref(gradient.c), self.moments, byref(adam))
