"""ms_ssim.py - the values that tests/test_metrics.c wants of MS-SSIM: Wang et al. 2003 written plainly, in float64, with numpy.

No separable blur, no rows, no threads: every whole 11 x 11 window is weighed as a square. Run it to see the values again.
"""
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

WEIGHTS = np.array([0.0448, 0.2856, 0.3001, 0.2363, 0.1333])
C1, C2 = 0.01**2, 0.03**2
TAP = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
WINDOW = np.outer(TAP, TAP) / np.outer(TAP, TAP).sum()


def noise(state, shape):
    """The generator of the test: a congruential one, the upper 24 bits."""
    out = np.empty(int(np.prod(shape)))
    for i in range(out.size):
        state = (state * 1664525 + 1013904223) % 2**32
        out[i] = (state >> 8) / 2**24
    return out.reshape(shape)


def smooth(x):
    """Means of 8 x 8 blocks, drawn large again: coarse scales have something to see."""
    h, w = x.shape[1] // 8 * 8, x.shape[2] // 8 * 8
    y = x.copy()
    blocks = x[:, :h, :w].reshape(3, h // 8, 8, w // 8, 8).mean(axis=(2, 4))
    y[:, :h, :w] = np.repeat(np.repeat(blocks, 8, axis=1), 8, axis=2)
    return y


def halve(x):
    h, w = x.shape[0] // 2 * 2, x.shape[1] // 2 * 2
    return x[:h, :w].reshape(h // 2, 2, w // 2, 2).mean(axis=(1, 3))


def terms(a, b, mask):
    """Means of S and of c s over whole windows that hold no masked pixel; None when there is none."""
    if min(a.shape) < 11:
        return None
    wa, wb, wm = (sliding_window_view(x, (11, 11)) for x in (a, b, mask))
    keep = wm.min(axis=(2, 3)) > 0
    if not keep.any():
        return None
    blur = lambda x: (x * WINDOW).sum(axis=(2, 3))
    ma, mb = blur(wa), blur(wb)
    va, vb, vab = blur(wa * wa) - ma * ma, blur(wb * wb) - mb * mb, blur(wa * wb) - ma * mb
    cs = (2 * vab + C2) / (va + vb + C2)
    s = (2 * ma * mb + C1) / (ma * ma + mb * mb + C1) * cs
    return s[keep].mean(), cs[keep].mean()


def channel(a, b, mask):
    found = []
    for _ in WEIGHTS:
        t = terms(a, b, mask)
        if t is None:
            break
        found.append(t)
        a, b, mask = halve(a), halve(b), (halve(mask) == 1).astype(float)
    w = WEIGHTS[: len(found)] / WEIGHTS[: len(found)].sum()
    values = [cs for _, cs in found[:-1]] + [found[-1][0]]
    return len(found), np.prod([max(v, 0) ** e for v, e in zip(values, w)])


def ms_ssim(a, b, mask=None):
    mask = np.ones(a.shape[1:]) if mask is None else mask
    per = [channel(a[c], b[c], mask) for c in range(3)]
    return per[0][0], np.mean([v for _, v in per])


def pair(width, height):
    a, b = noise(1, (3, height, width)), noise(2, (3, height, width))
    a = smooth(a) * 3.0 - 1.0  # some of it is clamped
    b = 0.75 * a + 0.25 * b
    return np.clip(a.astype(np.float32).astype(float), 0, 1), np.clip(b.astype(np.float32).astype(float), 0, 1)


for width, height, masked in ((200, 181, 0), (200, 181, 1), (61, 50, 0), (61, 50, 1), (37, 23, 0)):
    mask = np.ones((height, width))
    mask[:20, :30] = 1 - masked
    print(width, height, "corner masked:" if masked else "whole:", "%d scales, %.12f" % ms_ssim(*pair(width, height), mask))
