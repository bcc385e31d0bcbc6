#!/usr/bin/env python3
"""lpips.py WEIGHTS OUT/renders/*.image.png - LPIPS v0.1 with AlexNet of each render NAME.png, which lies beside its image NAME.image.png.

Zhang et al. 2018, The Unreasonable Effectiveness of Deep Features as a Perceptual Metric. Needs numpy and PIL (Debian: python3-numpy
python3-pil). lpips_weights.py writes WEIGHTS, little-endian: the line "LPIPS1 alex"; for each of 5 convolutions the shape as 4 uint32
(out, in, height, width), the weights and `out` biases as float32; for each of 5 heads a uint32 n and n float32.
"""
import struct
import sys

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from PIL import Image

STRIDE, PADDING, POOLED = [4, 1, 1, 1, 1], [2, 2, 1, 1, 1], [0, 1, 1, 0, 0]
SHIFT, SCALE = [-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]  # of AlexNet's training images, in -1..1
MAGIC = b"LPIPS1 alex\n"


def read_weights(path):
    data = open(path, "rb").read()
    at = len(MAGIC)

    def take(kind, count):
        nonlocal at
        at += 4 * count
        return np.frombuffer(data, kind, count, at - 4 * count)

    if not data.startswith(MAGIC):
        raise ValueError("the first line is another")
    convolutions, heads = [], []
    for _ in range(5):
        shape = take("<u4", 4)
        convolutions.append((take("<f4", int(np.prod(shape))).reshape(shape), take("<f4", int(shape[0]))))
    for _ in range(5):
        heads.append(take("<f4", int(take("<u4", 1)[0])))
    return convolutions, heads


def read_image(path):
    """(3,H,W) in -1..1"""
    return np.asarray(Image.open(path).convert("RGB"), np.float32).transpose(2, 0, 1) / 127.5 - 1


def features(x, convolutions):
    """Yields the five layers' features, each divided by its length at every pixel."""
    x = (x - np.reshape(SHIFT, (3, 1, 1))) / np.reshape(SCALE, (3, 1, 1))
    for (weight, bias), stride, padding, pooled in zip(convolutions, STRIDE, PADDING, POOLED):
        if pooled:
            x = sliding_window_view(x, (3, 3), (1, 2))[:, ::2, ::2].max((3, 4))
        x = np.pad(x, ((0, 0), (padding,) * 2, (padding,) * 2))
        windows = sliding_window_view(x, weight.shape[2:], (1, 2))[:, ::stride, ::stride]
        x = np.maximum(np.tensordot(weight, windows, ((1, 2, 3), (0, 3, 4))) + bias[:, None, None], 0)
        yield x / (np.sqrt((x**2).sum(0)) + 1e-10)


def distance(a, b, convolutions, heads):
    if a.shape != b.shape or min(a.shape[1:]) < 31:
        raise ValueError(f"images of {a.shape[2]} x {a.shape[1]} and {b.shape[2]} x {b.shape[1]} px; equal ones of at least 31 px are wanted")
    pairs = zip(features(a, convolutions), features(b, convolutions), heads)
    return sum(((f - g) ** 2 * head[:, None, None]).sum(0).mean() for f, g, head in pairs)


def main(weights, images):
    try:
        network = read_weights(weights)
    except (OSError, ValueError) as error:
        sys.exit(f"{weights}: these are not the weights of LPIPS with AlexNet ({error})\nfix: python3 examples/lpips_weights.py {weights} writes them")
    values = []
    for path in images:
        if not path.endswith(".image.png"):
            sys.exit(f"found '{path}', expected NAME.image.png\nfix: OUT/renders/*.image.png")
        values.append(distance(read_image(path), read_image(path[: -len(".image.png")] + ".png"), *network))
        print(f"{values[-1]:.5f}  {path}")
    print(f"{np.mean(values):.5f}  mean of {len(values)}, LPIPS (AlexNet)")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])
