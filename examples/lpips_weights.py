#!/usr/bin/env python3
"""lpips_weights.py FILE - writes the weights of LPIPS v0.1 with AlexNet, for `lpips.py FILE OUT/renders/*.image.png`.

pip install torch torchvision lpips; the convolutions are torchvision's (BSD-3-Clause), the linear heads those of the
package lpips (BSD-2-Clause). lpips.py states the layout.
"""
import struct
import sys

import lpips
import torch

net = lpips.LPIPS(net="alex", version="0.1", verbose=False).eval()
convolutions = [m for m in net.net.modules() if isinstance(m, torch.nn.Conv2d)]
heads = [net.lin0, net.lin1, net.lin2, net.lin3, net.lin4]
assert len(convolutions) == 5


def floats(tensor):
    return tensor.detach().cpu().float().contiguous().numpy().astype("<f4").tobytes()


with open(sys.argv[1], "wb") as out:
    out.write(b"LPIPS1 alex\n")
    for m in convolutions:
        out.write(struct.pack("<4I", *m.weight.shape) + floats(m.weight) + floats(m.bias))
    for head in heads:
        weight = next(m for m in head.modules() if isinstance(m, torch.nn.Conv2d)).weight
        out.write(struct.pack("<I", weight.numel()) + floats(weight))
