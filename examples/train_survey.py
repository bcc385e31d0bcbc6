#!/usr/bin/env python3
"""Trains a survey through the C library, with ctypes alone: make shared, then examples/train_survey.py SURVEY OUT.

Prints the progress and the held-out image quality. The functions are declared in oceanxl.h and oceanxl_job.h.
"""
import ctypes
import json
import pathlib
import sys

BUILD = pathlib.Path(__file__).resolve().parent.parent / "build"


class Progress(ctypes.Structure):
    """The first members of oxl_progress, in the order of oceanxl.h; the rest is not read here."""
    _fields_ = [("iteration", ctypes.c_int), ("iterations", ctypes.c_int), ("block", ctypes.c_int), ("blocks", ctypes.c_int),
                ("gaussians", ctypes.c_size_t), ("loss", ctypes.c_double), ("psnr", ctypes.c_double)]


PROGRESS = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(Progress))


class Callback(ctypes.Structure):
    _fields_ = [("progress", PROGRESS), ("user", ctypes.c_void_p)]


def load():
    library = ctypes.CDLL(str(BUILD / "liboceanxl.so"))
    library.oxl_context_create.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_void_p)]
    library.oxl_context_free.argtypes = [ctypes.c_void_p]
    library.oxl_error_text.argtypes = [ctypes.c_void_p]
    library.oxl_error_text.restype = ctypes.c_char_p
    library.oxl_job_run.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_char_p, ctypes.c_void_p, ctypes.POINTER(Callback)]
    return library


def train(survey, out, every=100):
    library, context = load(), ctypes.c_void_p()

    def show(_user, progress):
        p = progress.contents
        if p.iteration % every == 0:
            print(f"{p.iteration}/{p.iterations}  PSNR {p.psnr:.2f} dB  {p.gaussians} Gaussians")
        return 0  # another value stops the run; the same call resumes it

    callback = Callback(PROGRESS(show), None)  # keep a reference while C may call it
    if library.oxl_context_create(None, ctypes.byref(context)) != 0:
        sys.exit("no memory for a context")
    result = library.oxl_job_run(context, survey.encode(), out.encode(), None, ctypes.byref(callback))
    error = library.oxl_error_text(context).decode()
    library.oxl_context_free(context)
    if result != 0:
        sys.exit(error)
    metrics = json.loads((pathlib.Path(out) / "metrics.json").read_text())
    print(f"held-out views: PSNR {metrics['psnr']:.2f} dB, SSIM {metrics['ssim']:.4f}; {out}/scene.ply")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    train(sys.argv[1], sys.argv[2])
