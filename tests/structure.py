"""structure.py - the values that tests/test_metrics.c wants of oxl_structure, written plainly, in float64, with numpy.

A square window for each pixel of an image that numpy pads with its own reflection: nothing separable, no rows, no threads.
Run it to see the values again.
"""
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

W, H = 37, 23


def noise(state, shape):
    """The generator of the test: a congruential one, the upper 24 bits."""
    out = np.empty(int(np.prod(shape)))
    for i in range(out.size):
        state = (state * 1664525 + 1013904223) % 2**32
        out[i] = (state >> 8) / 2**24
    return out.reshape(shape)


def window(sigma):
    half = int(4 * sigma + 0.5)
    tap = np.exp(-(np.arange(-half, half + 1) ** 2) / (2 * sigma**2))
    return np.outer(tap, tap) / np.outer(tap, tap).sum()


def mean(x, sigma):
    w = window(sigma)
    return (sliding_window_view(np.pad(x, w.shape[0] // 2, mode="symmetric"), w.shape) * w).sum((2, 3))


def band(x, weight):
    return weight * (mean(x * weight, 1) / mean(weight, 1) - mean(x * weight, 6) / mean(weight, 6))


def structure(a, b, weight):
    a, b = band(np.clip(a, 0, 1).mean(0), weight), band(np.clip(b, 0, 1).mean(0), weight)
    return (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()), (mean(a * b, 6) / np.sqrt(mean(a * a, 6) * mean(b * b, 6)))[10, 20]


if __name__ == "__main__":
    a = noise(1, (3, H, W))
    b = (0.75 * a + 0.25 * noise(2, (3, H, W))).astype(np.float32).astype(float)
    ones, corner = np.ones((H, W)), np.ones((H, W))
    corner[:4, :9] = 0
    print("whole  %.15g  at (20, 10) %.9g" % structure(a, b, ones))
    print("masked %.15g  at (20, 10) %.9g" % structure(a, b, corner))
