"""lpips.py - the values that tests/test_lpips.c wants: LPIPS written plainly, in float64, with numpy. Run it to see them again.

Convolutions as sums over windows; no rows, no threads. The weights and the images are those of the test's generator.
"""
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

CHANNELS, SIZES = [3, 5, 6, 7, 5, 4], [11, 5, 3, 3, 3]
STRIDES, PADDING, POOLED = [4, 1, 1, 1, 1], [2, 2, 1, 1, 1], [0, 1, 1, 0, 0]
SHIFT, SCALE = np.array([-0.030, -0.088, -0.188]), np.array([0.458, 0.448, 0.450])


class Random:
    """A congruential generator, the upper 24 bits: from -1 to 1, as float32."""

    def __init__(self, state):
        self.state = state

    def draw(self, count):
        out = np.empty(count, np.float32)
        for i in range(count):
            self.state = (self.state * 1664525 + 1013904223) % 2**32
            out[i] = np.float32(self.state >> 8) / np.float32(8388608) - np.float32(1)
        return out


def weights():
    r, conv, head = Random(7), [], []
    for k in range(5):
        taps = CHANNELS[k] * SIZES[k] ** 2
        w = r.draw(CHANNELS[k + 1] * taps) * np.float32(2) / np.float32(np.sqrt(taps))
        conv.append((w.reshape(CHANNELS[k + 1], CHANNELS[k], SIZES[k], SIZES[k]).astype(float), (r.draw(CHANNELS[k + 1]) / 4).astype(float)))
    for k in range(5):
        head.append(((r.draw(CHANNELS[k + 1]) + 1) / 2).astype(float))
    return conv, head


def features(x, conv):
    x = (2 * x - 1 - SHIFT[:, None, None]) / SCALE[:, None, None]
    for k, (w, b) in enumerate(conv):
        if POOLED[k]:
            x = sliding_window_view(x, (3, 3), (1, 2))[:, ::2, ::2].max((3, 4))
        p = np.pad(x, ((0, 0), (PADDING[k],) * 2, (PADDING[k],) * 2))
        windows = sliding_window_view(p, w.shape[2:], (1, 2))[:, :: STRIDES[k], :: STRIDES[k]]
        x = np.maximum(np.einsum("chwij,ocij->ohw", windows, w) + b[:, None, None], 0)
        yield x


def distance(a, b, conv, head):
    total = 0
    for f, g, h in zip(features(a, conv), features(b, conv), head):
        f, g = (v / (np.sqrt((v**2).sum(0)) + 1e-10) for v in (f, g))
        total += ((f - g) ** 2 * h[:, None, None]).sum(0).mean()
    return total


if __name__ == "__main__":
    conv, head = weights()
    for width, height in (64, 64), (71, 93), (130, 67), (31, 40):
        r = Random(11)
        a = (r.draw(3 * width * height) + 1) / 2
        b = (a + (r.draw(3 * width * height) + 1) / 2) / 2
        shape = 3, height, width
        print("{%d, %d, %.7f}," % (width, height, distance(a.reshape(shape).astype(float), b.reshape(shape).astype(float), conv, head)))
