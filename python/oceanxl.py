"""oceanxl - 3D Gaussian Splatting of underwater surveys: the library of oceanxl.h, by ctypes and numpy.

    import oceanxl as oxl
    scene = oxl.load("survey", max_side=320)
    model = oxl.train(scene, preset="draft", iterations=500)
    image, depth, alpha = oxl.render(model, scene.views[3])
    print(oxl.metrics(image, scene.views[3].image), oxl.evaluate(model, scene)["psnr"])
    model.write("out")
    model = oxl.Model.read("out", scene)

A trained model's `imaging`, if not None, lies between its colours and the images: gains of each image, a lamp, a medium. write keeps it,
save does not; medium="off", exposure="off", lamp="off" omit it. Images are (H,W,3) floats, 0 black and 1 white; a view's is read anew
each time. model.means, .scales, .quats, .opacities and .sh are the library's memory: what is written to them is in the model. All but
.opacities are planar in memory, not C-contiguous. Parameters are raw: log scale, logit opacity, quaternion w x y z. `lib` has oceanxl.h, less oxl_fail.
"""
import contextlib
import difflib
import json
import os
import pathlib
import signal
import sys
import tempfile
import threading
import time
import warnings
import weakref
from collections import namedtuple
from ctypes import (CDLL, CFUNCTYPE, POINTER, Array, Structure, byref, c_char_p, c_double, c_float, c_int, c_size_t, c_uint8, c_uint64,
                    c_void_p, cast, pointer)
from types import SimpleNamespace

import numpy as np


def _open():
    here, given = pathlib.Path(__file__).resolve().parent, os.environ.get("OXL_LIBRARY")
    places = [pathlib.Path(given)] if given else [here / "liboceanxl.so", here.parent / "build" / "liboceanxl.so"]
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # OpenMP reads it when it is loaded: threads that wait must not spin
    found = [place for place in places if place.exists()]
    if found:
        return CDLL(str(found[0]))
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
__version__ = OXL_VERSION
__all__ = ("load train render render_image render_backward evaluate metrics camera write_image Scene View Model Adam Context Error "
           "OXL_REMOVE OXL_KEEP OXL_SPLIT").split()


# ---------------------------------------------------------------- options, contexts, memory

CALLS = {oxl_context_options: "Context", oxl_scene_options: "load", oxl_train_options: "train"}
FLOATS, Render = POINTER(c_float), namedtuple("Render", "image depth alpha")


def _want(value, kind, name):
    """The value, if it is of a class, or a number that a C type or an enum (its name) holds, or the word for it; else an error."""
    words = WORDS[kind] if isinstance(kind, str) else {"off": 0, "on": 1, "auto": -1} if kind in (c_int, c_float) else {}
    given, error = words.get(value, value) if isinstance(value, str) else value, ValueError
    if isinstance(kind, str):
        fits, wanted = given in words.values(), f"one of {', '.join(words)}"
    elif kind in (c_float, c_double):
        fits, wanted = isinstance(given, (int, float, np.number)), "a number"
    elif kind in (c_int, c_size_t, c_uint64):
        given = int(given) if isinstance(given, (int, np.integer)) else None
        fits, wanted = given is not None and kind(given).value == given, f"an integer of type {kind.__name__[2:]}"
    else:
        fits, wanted, error = isinstance(given, kind), f"a {kind.__name__}", TypeError
    if fits:
        return given
    raise error(f"{name} is {value!r:.80}, wanted {wanted}")


def _numbers(value, shape, name):
    """The value as an array of finite numbers."""
    with contextlib.suppress(TypeError, ValueError):
        array = np.asarray(value, float)
        if array.shape == shape and np.isfinite(array).all():
            return array
    raise ValueError(f"{name} is {value!r:.200}, wanted {' x '.join(map(str, shape))} finite numbers")


def _fill(struct, values):
    """Sets options: words for enums, sequences for arrays, dictionaries for structs, text and paths for char *."""
    names, of = dict(struct._fields_), type(struct)
    for name, value in values.items():
        if name not in names:
            others = [f"it is one of {call}" for kind, call in CALLS.items() if hasattr(kind, name)]
            near = ", ".join(difflib.get_close_matches(name, names) or names)
            raise TypeError(f"{CALLS.get(of, of.__name__)} has no option {name!r}: {others[0] if others else 'wanted ' + near}")
        now, least = getattr(struct, name), -1 if name in ("test_every", "device") else 0
        if isinstance(now, Structure):
            _fill(now, value if isinstance(value, dict) else {now._fields_[0][0]: value})
        elif isinstance(now, Array):
            now[:] = _numbers(value, (len(now),), name)
        elif names[name] is c_char_p:
            setattr(struct, name, None if value is None else os.fsencode(value))
        else:
            setattr(struct, name, _want(value, CHOICES.get(f"{of.__name__}.{name}", names[name]), name))
            if names[name] is c_int and of is not oxl_train_options and getattr(struct, name) < least:
                raise ValueError(f"{name} is {value}, wanted {least} or more")
    return struct


def _train_options(context, preset, options):
    o = _fill(lib.oxl_train_options_default(_want(preset, "oxl_preset", "preset")), options)
    context.call(lib.oxl_train_options_check, byref(o))
    return o


class Error(RuntimeError):
    """The library's text: what was found, what was expected, a fix; and `code`, one of OXL_ERR_*."""

    def __init__(self, code, text):
        super().__init__(text)
        self.code = code


class Context:
    """Threads, seed and log(level, text). Scenes and models keep the context that they were made with."""

    def __init__(self, threads=0, seed=1, log=None, **options):
        o = _fill(lib.oxl_context_options_default(), dict(options, threads=threads, seed=seed))
        log = log or (lambda level, text: level <= OXL_LOG_WARNING and print(f"oceanxl: {text}", file=sys.stderr))
        self.lock, self.c, self.state = threading.RLock(), c_void_p(), SimpleNamespace(listens=False, presses=0, raised=None)
        o.log = type(o.log)(self.guarded(lambda level, text: log(level, text.decode(errors="replace"))))
        o.stopped = type(o.stopped)(self.guarded(lambda state=self.state: state.presses))
        if lib.oxl_context_create(byref(o), byref(self.c)) != OXL_OK:
            raise Error(OXL_ERR_FAILED, lib.oxl_error_text(None).decode())
        weakref.finalize(self, lambda c, _o: lib.oxl_context_free(c), self.c, o)

    def guarded(self, function):
        """A callback for C. What it raises is kept, stops what the library does, and is raised behind it."""
        def call(_user, *arguments, state=self.state):
            try:
                return 1 if state.raised else function(*arguments)
            except BaseException as raised:
                state.raised = None if state.presses == 1 and isinstance(raised, KeyboardInterrupt) else raised
                return 1
        return call

    def call(self, function, *arguments, allowed=OXL_OK):
        """Calls the library. Ctrl-C ends what it reads, measures or trains; a second one is raised at once."""
        def press(*_):
            state.presses += 1
            if state.presses > 1:
                raise KeyboardInterrupt
        state, old = self.state, None
        with self.lock:  # a context is used by one thread at a time
            if not state.listens and threading.current_thread() is threading.main_thread():
                old, state.listens = signal.signal(signal.SIGINT, press), True
            try:
                code, raised, state.raised = function(self.c, *arguments), state.raised, None
                if raised or (state.presses and allowed != OXL_ERR_INTERRUPTED):
                    raise raised or KeyboardInterrupt
            finally:
                if old is not None:
                    signal.signal(signal.SIGINT, old)
                    state.listens, state.presses = False, 0
            if code not in (OXL_OK, allowed):
                raise Error(code, lib.oxl_error_text(self.c).decode(errors="replace"))
            return code


def _context(given=None, first=[]):  # first: shared by all that give none
    if not given and not first:
        first.append(Context())
    return _want(given or first[0], Context, "context")


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
    plain = np.empty(shape, kind)
    if not plain.size:
        return plain
    strides = strides or plain.strides
    last = sum((n - 1) * s for n, s in zip(shape, strides)) + plain.itemsize
    memory = (c_uint8 * last).from_address(cast(at, c_void_p).value)
    memory.owner = owner
    return np.ndarray(shape, kind, memory, strides=strides)


# ---------------------------------------------------------------- scenes and images

def _image_arrays(owner, image):
    """(H,W,3), in memory as the library has it: (3,H,W); its weight (H,W), or None."""
    size = image.height, image.width
    return np.moveaxis(_array(owner, image.rgb, (3, *size)), 0, -1), _array(owner, image.weight, size) if image.weight else None


def _planar(image):
    """(3,H,W) floats of an (H,W,3) image; a copy only where the memory is laid out in another way."""
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or not np.issubdtype(image.dtype, np.floating):
        raise ValueError(f"an image has the shape {image.shape} and is of {image.dtype}, wanted (height, width, 3) floats, 0 to 1")
    return np.ascontiguousarray(np.moveaxis(image, -1, 0), np.float32)


def _image(image, weight=None):
    rgb = _planar(image)
    out = oxl_image(rgb.shape[2], rgb.shape[1], rgb.ctypes.data_as(FLOATS))
    if weight is not None:
        weight = _numbers(weight, rgb.shape[1:], "weight").astype(np.float32)
        out.weight = weight.ctypes.data_as(FLOATS)
    out.kept = rgb, weight
    return out


class View:
    """An image and the camera that took it. pose: (4,4) local coordinates to camera, as gsplat's viewmats; K: (3,3), as its Ks."""

    image = property(lambda self: self.read()[0])
    weight = property(lambda self: self.read()[1])
    __repr__ = lambda self: f"<View {self.index}: {self.name}, {self.camera.width} x {self.camera.height}{', held out' * self.is_test}>"

    def __init__(self, scene, index):
        view = lib.oxl_scene_view(scene.c, index).contents
        self.scene, self.index, self.name, self.is_test = scene, index, os.fsdecode(view.name), bool(view.is_test)
        self.camera = c = view.camera
        self.K, self.pose = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]]), np.eye(4)
        self.pose[:3, :3], self.pose[:3, 3] = np.reshape(c.rotation, (3, 3)), c.translation

    def read(self, background=None):
        """The image (H,W,3) and its weight (H,W), 0 where it is masked; None: no pixel is. Read anew at each call. What is transparent lies
        over the background, (3), or white: compare it with a render on the same."""
        owned = _Owned(self.scene.context, oxl_image, lib.oxl_image_free)
        behind = None if background is None else (c_float * 3)(*_numbers(background, (3,), "background"))
        self.scene.context.call(lib.oxl_scene_image, self.scene.c, self.index, behind, byref(owned.c))
        return _image_arrays(owned, owned.c)


def camera(width, height, K, pose):
    """A camera to render from: size in px, (3,3) intrinsics, (4,4) world to camera, in the scene's local coordinates."""
    K, pose, size = _numbers(K, (3, 3), "K"), _numbers(pose, (4, 4), "pose"), (_want(n, c_int, "size") for n in (width, height))
    R = pose[:3, :3]
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0:
        raise ValueError(f"pose[:3, :3] is {R.tolist()}, wanted a rotation")
    return oxl_camera(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(R.ravel()), tuple(pose[:3, 3]))


class Scene:
    """Views, and points, (N) records of position, error and rgb, relative to `origin`: world = local + origin."""

    __repr__ = lambda self: f"<Scene of {len(self.views)} views, {len(self.training)} of them for training, {len(self.points)} points>"

    def __init__(self, owned):
        self._owned, self.context, self.c = owned, owned.context, owned.c
        self.views = [View(self, i) for i in range(lib.oxl_scene_view_count(self.c))]
        self.training = [v for v in self.views if not v.is_test]
        self.origin = np.array(lib.oxl_scene_origin(self.c)[:3])
        self.extent, self.near_plane = lib.oxl_scene_extent(self.c), lib.oxl_scene_near_plane(self.c)
        record = np.dtype([("position", "f8", 3), ("error", "f4"), ("rgb", "u1", 3)], align=True)
        self.points = _array(owned, lib.oxl_scene_points(self.c), (lib.oxl_scene_point_count(self.c),), record)

    @property
    def background(self):
        """(3) What training takes: white where transparent images are composited, else black. A render of no Gaussian shows it."""
        nothing, image = Model.create(0, context=self.context), _Owned(self.context, oxl_image, lib.oxl_image_free)
        self.context.call(lib.oxl_render_view, byref(nothing.c), self.c, 0, None, byref(image.c), None)
        return np.array(_image_arrays(image, image.c)[0][0, 0])


def load(path, context=None, **options):
    """Reads a survey. Options, of oxl_scene_options: max_side=1600 (px), test_every=-1 (8, or as the survey says), images, sparse, masks
    (folders), alpha="auto" (or "composite", "mask"), image_cache_bytes=1 << 30."""
    context, o = _context(context), _fill(lib.oxl_scene_options_default(), options)
    owned = _Owned(context, c_void_p, lib.oxl_scene_free)
    context.call(lib.oxl_scene_load, os.fsencode(path), byref(o), byref(owned.c))
    return Scene(owned)


def write_image(path, image):
    """Writes an 8-bit PNG."""
    if not os.fspath(path).lower().endswith(".png"):
        raise ValueError(f"the path is {str(path)!r}, wanted one that ends in .png")
    _context().call(lib.oxl_image_write, os.fsencode(path), byref(_image(image)))


# ---------------------------------------------------------------- models

def _parameter(first, number, text, shape=None):
    def read(self):
        planes = self._planes(first, number if number else 3 * (self.c.sh_degree + 1) ** 2)
        return shape(planes) if shape else planes.T
    return property(read, lambda self, value: np.copyto(read(self), value), doc=text)


class Model:
    """Gaussians, in local coordinates: world = local + origin. len(model) is their number, model[rows] a copy, in which second lobes come
    first. Training also sets imaging, viewer (for other viewers, if trained apart), iterations, finished, seconds, decisions."""

    __slots__ = "_owned context c imaging scene lent viewer iterations finished seconds decisions __weakref__".split()
    __iter__ = None
    means = _parameter(OXL_MEAN, 3, "(N,3) local coordinates")
    scales = _parameter(OXL_LOG_SCALE, 3, "(N,3) log of the standard deviations")
    quats = _parameter(OXL_ROTATION, 4, "(N,4) w x y z, of any length")
    opacities = _parameter(OXL_OPACITY, 1, "(N) logit", lambda planes: planes[0])
    sh = _parameter(OXL_SH, 0, "(N,K,3) spherical harmonics; colour = max(0, 0.5 + sum of basis x coefficient)",
                    lambda planes: planes.reshape(len(planes) // 3, 3, -1).transpose(2, 0, 1))
    lobes = _parameter(OXL_LOBE, 4, "(M,4) factors of the second lobes, which the first M Gaussians have: logit of opacity, log of scales")
    sh_degree = property(lambda self: self.c.sh_degree)
    origin = property(lambda self: np.array(self.c.origin[:]))
    copy = lambda self: self[:]
    __len__ = lambda self: self.c.count
    __repr__ = lambda self: f"<Model of {len(self)} Gaussians, SH degree {self.sh_degree}{', with imaging' if self.imaging else ''}>"
    antialias = property(lambda self: bool(self.c.antialias), lambda self, on: setattr(self.c, "antialias", bool(on)),
                         doc="True: a low pass of 0.1 px^2 that keeps a Gaussian's light; training sets it, except by preset \"paper\"")

    def _set_background(self, rgb):
        self.c.background[:], self.c.has_background = _numbers(rgb, (3,), "background"), 1
    background = property(lambda self: np.array(self.c.background[:]), _set_background, doc="(3) the colour behind the Gaussians")

    def __init__(self, owned, c=None, context=None):
        self._owned, self.context, self.c = owned, context or owned.context, owned.c if c is None else c
        self.imaging = self.scene = self.viewer = None
        self.lent = None if owned else {}  # (copy, planes) by their first, of a model that is the library's, for the time of a callback

    @classmethod
    def _made(cls, context, scene, function, *arguments):
        """A model that a function makes; with a scene, of its origin, and of its background if it has none."""
        model = cls(_Owned(scene.context if scene else _context(context), oxl_model, lib.oxl_model_free))
        model.context.call(function, *arguments, byref(model.c))
        if scene:
            model.scene, model.c.origin[:] = scene, scene.origin
            model.background = model.background if model.c.has_background else scene.background
        return model

    @classmethod
    def create(cls, count, sh_degree=0, context=None, scene=None):
        """All values are 0, except rotations: the identity. The model has the scene's origin and background."""
        return cls._made(context, scene, lib.oxl_model_create, _want(count, c_size_t, "count"), _want(sh_degree, c_int, "sh_degree"))

    @classmethod
    def from_points(cls, scene, sh_degree=0):
        """A round Gaussian for each of the scene's points [Kerbl 2023]."""
        count = len(_want(scene, Scene, "scene").points)
        if not count:
            raise ValueError("the scene has no points\nfix: train(scene), or Model.create(count, scene=scene)")
        return cls._made(None, scene, lib.oxl_model_from_points, lib.oxl_scene_points(scene.c), count, _want(sh_degree, c_int, "sh_degree"))

    @classmethod
    def read(cls, path, scene=None, context=None):
        """Reads .ply, .splat or .spz, or the folder of a result: its scene_clear.ply, else scene.ply. With a scene also the imaging beside
        it, and the model is moved to the scene's origin."""
        path = pathlib.Path(path)
        if path.is_dir():
            path /= "scene_clear.ply" if (path / "scene_clear.ply").exists() else "scene.ply"
        model = cls._made(scene.context if scene else context, None, lib.oxl_model_read, os.fsencode(path))
        if scene:
            lib.oxl_model_move_origin(byref(model.c), lib.oxl_scene_origin(scene.c))
            imaging, model.scene = _Owned(scene.context, c_void_p, lib.oxl_imaging_free), scene
            scene.context.call(lib.oxl_imaging_read, os.fsencode(path), scene.c, byref(imaging.c))
            model.imaging = imaging if imaging.c else None
        elif (path.parent / "imaging.txt").exists():
            warnings.warn(f"{path.parent}/imaging.txt is not read\nfix: Model.read(path, scene)", stacklevel=2)
        return model

    def save(self, path):
        """Writes .ply, .splat or .spz, without the imaging: write(folder) keeps it."""
        if self.imaging:
            warnings.warn(f"{path} lacks the imaging\nfix: model.write(folder), then Model.read(folder, scene)", stacklevel=2)
        self.context.call(lib.oxl_model_write, os.fsencode(path), byref(self.c))

    def write(self, folder):
        """Writes what `oceanxl train` writes: scene.ply for viewers; scene_clear.ply, where that has the medium or gains in its colours;
        imaging.txt and scene_standard.ply, where needed. Model.read(folder, scene) reads it."""
        scene = _want(self.scene, Scene, "model.scene, which read, create and from_points set,")
        os.makedirs(folder, exist_ok=True)
        result = oxl_trained(model=self.c, imaging=self.imaging and self.imaging.c.value, viewer=getattr(self.viewer, "c", oxl_model()))
        self.context.call(lib.oxl_trained_write, os.fsencode(folder), scene.c, byref(result))

    def _planes(self, first, number):
        m, rows = self.c, self.c.lobes if first == OXL_LOBE else self.c.count
        at = [cast(m.plane[first + k], c_void_p).value for k in range(min(number, 2))]
        planes = _array(self._owned, m.plane[first], (number, rows), strides=(at[-1] - at[0] if rows else 0, 4))
        return planes if self.lent is None else self.lent.setdefault(first, (planes.copy(), planes))[0]

    def __getitem__(self, rows):
        rows = np.atleast_1d(np.arange(len(self))[rows])
        rows = rows[np.argsort(rows >= self.c.lobes, kind="stable")]
        out, lobes = Model.create(len(rows), self.c.sh_degree, self.context), np.count_nonzero(rows < self.c.lobes)
        if lobes:  # in four planes of another model
            out._owned.lobes = kept = Model.create(lobes, context=self.context)
            out.c.lobes, out.c.plane[OXL_LOBE:] = lobes, kept.c.plane[:OXL_PLANES - OXL_LOBE]
        for name in "means", "scales", "quats", "opacities", "sh", "lobes":
            setattr(out, name, getattr(self, name)[rows[:lobes] if name == "lobes" else rows])
        for name in ("origin", "scale", "background", "has_background", "antialias", "view"):
            setattr(out.c, name, getattr(self.c, name))
        out.imaging, out.scene = self.imaging, self.scene
        return out


# ---------------------------------------------------------------- rendering and metrics

def _fits(model, scene):
    """Raises unless the model has the scene's origin, and its imaging is of the scene's views."""
    if not np.array_equal(_want(model, Model, "model").origin, _want(scene, Scene, "scene").origin):
        raise ValueError(f"the model's origin is {model.origin.tolist()}, the scene's {scene.origin.tolist()}\n"
                         "fix: Model.read(path, scene), or Model.create(count, scene=scene)")
    if model.imaging and model.scene is not scene and [v.name for v in model.scene.views] != [v.name for v in scene.views]:
        raise ValueError("the model's imaging is of other views than the scene's\nfix: model.imaging = None")


def _seen(model, view, background):
    """The model on a background, the camera of a view, or a camera, and options to render by."""
    o, c = lib.oxl_render_options_default(), oxl_model.from_buffer_copy(_want(model, Model, "model").c)
    scene = view.scene if isinstance(view, View) else None
    if scene:
        _fits(model, scene)
        o.near_plane = scene.near_plane
        background = scene.background if background is None and not c.has_background else background
    if background is not None:
        c.background[:], c.has_background = _numbers(background, (3,), "background"), 1
    o.background[:] = c.background
    return c, view.camera if scene else _want(view, oxl_camera, "view"), o


def render_image(model, view, imaging=True, background=None, _depth=None):
    """The image (H,W,3) of a view, or of a camera, on a background, (3), or the model's. imaging: as the view's image was taken, with the
    model's gains, lamp, medium and pose; False: the model's own colours, of which render_backward is the derivative."""
    (c, at, o), owned = _seen(model, view, background), _Owned(model.context, oxl_image, lib.oxl_image_free)
    if isinstance(view, View) and imaging and model.imaging:
        model.context.call(lib.oxl_render_view, byref(c), view.scene.c, view.index, model.imaging.c, byref(owned.c), _depth)
    else:
        model.context.call(lib.oxl_render, byref(c), byref(at), byref(o), byref(owned.c), _depth)
    return _image_arrays(owned, owned.c)[0]


def render(model, view, imaging=True, background=None):
    """As render_image; depth (H,W), camera z of the surface, negative where it is doubtful, 0 where there is none; alpha (H,W). The last
    costs two more renders: render_image gives the image alone."""
    _, at, _ = _seen(model, view, background)
    depth = np.zeros((at.height, at.width), np.float32)
    black, white = (render_image(model, view, False, (g, g, g)) for g in (0, 1))
    return Render(render_image(model, view, imaging, background, depth.ctypes.data_as(FLOATS)), depth, 1 - (white - black)[..., 0])


def render_backward(model, view, dimage, background=None):
    """A Model that holds the gradient of a loss in each parameter, from that in each pixel of render_image(model, view, False)."""
    (c, at, o), drgb = _seen(model, view, background), _planar(dimage)
    if drgb.shape != (3, at.height, at.width):
        raise ValueError(f"the gradient of an image has the shape {np.shape(dimage)}, wanted {(at.height, at.width, 3)}")
    return Model._made(model.context, None, lib.oxl_render_backward, byref(c), byref(at), byref(o), drgb.ctypes.data_as(FLOATS))


def metrics(image, reference, weight=None):
    """PSNR (dB), colour-corrected PSNR, SSIM and structure of an image against another; weight (H,W) 0: pixels that do not count. NaN: a
    value is not finite, or too little counts or shows detail."""
    a, b, out, value = _image(image), _image(reference, weight), {}, c_double()
    finite = np.isfinite(a.kept[0]).all() and np.isfinite(b.kept[0]).all()
    for name in ("psnr", "cc_psnr", "ssim", "structure"):
        code = _context().call(getattr(lib, f"oxl_{name}"), byref(a), byref(b), byref(value), allowed=OXL_ERR_INPUT)
        out[name] = value.value if finite and code == OXL_OK else np.nan
    return out


def evaluate(model, scene, split="test"):
    """Means over the views of a split, "test", "train" or "all", and `views`, a row each."""
    _fits(model, scene)
    owned, split = _Owned(scene.context, oxl_metrics, lib.oxl_metrics_free), _want(split, "oxl_split", "split")
    scene.context.call(lib.oxl_evaluate, byref(model.c), scene.c, model.imaging.c if model.imaging else None, split, byref(owned.c))
    if not owned.c.count:
        raise ValueError("the split has no view\nfix: load(path, test_every=8), or evaluate(model, scene, \"train\")")

    def row(struct):
        return {n: list(v) if isinstance(v, Array) else v for n, _ in struct._fields_ if n != "views" for v in [getattr(struct, n)]}
    return dict(row(owned.c), views=[row(owned.c.views[i]) for i in range(owned.c.count)])


# ---------------------------------------------------------------- training

class _Run:
    """The callbacks of a run. They get copies of arrays, which may be kept, and models that end with the call."""

    def __init__(self, context, steps, show, callback, terms):
        self.context, self.steps, self.show, self.callback, self.of, self.shown = context, steps, show, callback, terms, 0
        self.c, self.terms = oxl_callback(dict(oxl_callback._fields_)["progress"](context.guarded(self._progress))), oxl_terms()
        for name in terms:
            setattr(self.terms, name, dict(oxl_terms._fields_)[name](context.guarded(getattr(self, f"_{name}"))))

    @contextlib.contextmanager
    def _model(self, m, changes=False):
        model = Model(None, m.contents, self.context)
        try:
            yield model
            for copy, planes in model.lent.values() if changes else ():
                planes[...] = copy
        finally:
            del model.c

    def say(self, text, always=False):
        if self.show and (always or time.monotonic() - self.shown > (0.2 if sys.stderr.isatty() else 10)):
            self.shown = time.monotonic()
            print(text, end="   \r" if sys.stderr.isatty() and not always else "\n", file=sys.stderr, flush=True)

    def _progress(self, progress):
        p = SimpleNamespace(**{n: getattr(progress.contents, n) for n, _ in oxl_progress._fields_})
        p.stage = "viewer" if p.iteration > self.steps else "model"
        p.nonfinite = {n: getattr(p.nonfinite, n) for n, _ in oxl_nonfinite._fields_}
        with self._model(p.model) as p.model:
            ends = bool((self.callback and self.callback(p)) or self.context.state.presses)
        left = f"  {p.seconds_left:.0f} s left" if p.seconds_left >= 0.5 else ""
        self.say(f"{p.iteration}/{p.iterations}  loss {p.loss:.4f}  PSNR {p.psnr:.2f} dB  {p.gaussians} Gaussians{left}",
                 ends or p.iteration == p.iterations)
        return ends

    def _pixels(self, rendered, image, drgb):
        arrays = _image_arrays(None, rendered.contents)[0], *_image_arrays(None, image.contents)
        value, gradient = self.of["pixels"](*(a if a is None else a.copy("K") for a in arrays))
        np.moveaxis(_array(None, drgb, (3, *arrays[0].shape[:2])), 0, -1)[...] += gradient
        return float(value)

    def _parameters(self, model, gradient):
        with self._model(model) as m, self._model(gradient, True) as g:
            return float(self.of["parameters"](m, g))

    def _density(self, model, gradient, views, change):
        arrays = [_array(None, a, (model.contents.count,), k) for a, k in ((gradient, "f4"), (views, "f4"), (change, "u1"))]
        copies = [a.copy() for a in arrays]
        with self._model(model) as m:
            self.of["density"](m, *copies)
        arrays[2][:] = copies[2]


def train(scene, preset="draft", start=None, callback=None, pixels=None, parameters=None, density=None, progress=True, **options):
    """Trains as `oceanxl train` does one block. Options, of oxl_train_options: iterations=1200 by preset "draft", sh_degree="auto",
    max_gaussians=0 (by points), exposure, lamp and medium="auto" (or "on", "off"). Ctrl-C returns the model so far, with .finished False;
    before the first step it raises KeyboardInterrupt. Callbacks get copies, which may be kept, but models that end with the call.

    start         a model, or its path, to begin with, instead of the scene's points. It begins with the colours of scene.ply, and the run
                  has all of its schedule, so rates are high again and PSNR falls at first
    callback(p)   after each step, p as oxl_progress; what is true stops the run. p.stage "viewer": steps after `iterations`, in which
                  .viewer is trained, for viewers that do not know the imaging
    pixels(rendered, image, weight) -> (value, gradient)    a term in the loss, and d/d rendered (H,W,3); weight None: no pixel is masked
    parameters(model, gradient) -> value    a term that adds to gradient.means, .scales and so on
    density(model, gradient, views, change) rewrites change: OXL_REMOVE, OXL_KEEP or OXL_SPLIT; gradient / views is the mean of |dL/d(u, v)|
    """
    context = _want(scene, Scene, "scene").context
    o, owned = _train_options(context, preset, options), _Owned(context, oxl_trained, lib.oxl_trained_free)
    terms = {n: f for n, f in (("pixels", pixels), ("parameters", parameters), ("density", density)) if f}
    run = _Run(context, o.iterations, progress, callback, terms)
    if terms:
        o.terms = pointer(run.terms)
    if start is not None:
        start = Model.read(start, scene) if isinstance(start, (str, os.PathLike)) else _want(start, Model, "start")
        _fits(start, scene)
        with tempfile.TemporaryDirectory() as folder:
            if start.imaging:  # is measured anew, from the colours of scene.ply
                start.write(folder)
                start = Model.read(folder + "/scene.ply", scene)
        setattr(o, "from", pointer(start.c))
    run.say(f"preparing {o.iterations} steps", True)
    context.call(lib.oxl_train, scene.c, byref(o), byref(run.c), byref(owned.c), allowed=OXL_ERR_INTERRUPTED)
    if not owned.c.model.count:
        raise KeyboardInterrupt
    model, c = Model(owned, owned.c.model), owned.c
    model.scene, model.viewer = scene, Model(owned, c.viewer) if c.viewer.count else None
    model.iterations, model.finished, model.seconds = c.iterations, bool(c.finished), c.seconds
    model.decisions = json.loads("{" + (c.decisions or b"").decode() + "}")
    parts = "exposure", "lamp", "medium", "poses"
    if any(getattr(o, n) == OXL_ON or model.decisions.get(n, {}).get("chosen", "off") != "off" for n in parts):
        model.imaging = SimpleNamespace(c=c_void_p(c.imaging), owner=owned)
    return model


class Adam:
    """Adam with the rates of a run of `iterations` steps, for a loop of one's own: adam.step(gradient) moves the model."""

    def __init__(self, model, scene, preset="draft", **options):
        _fits(model, scene)
        self.model, self.scene, self.steps, self.moments = model, scene, 0, (oxl_model * 2)()
        self.options = _train_options(scene.context, preset, options)
        for moment in self.moments:
            weakref.finalize(self, _Owned.release, model.context, lib.oxl_model_free, moment)

    def step(self, gradient):
        self.steps += 1
        adam, c = lib.oxl_adam_at(self.scene.c, byref(self.options), self.steps), _want(gradient, Model, "gradient").c
        self.model.context.call(lib.oxl_adam_step, byref(self.model.c), byref(c), self.moments, byref(adam))
