#!/usr/bin/env python3
"""Trains a survey from Python: make python, then examples/train_survey.py SURVEY [OUT].

Prints progress and the quality of held-out images; OUT gets the files that `oceanxl train` writes. Ctrl-C stops, and keeps the model so far.
"""
import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "python"))  # not needed after pip install
import oceanxl as oxl

if not 2 <= len(sys.argv) <= 3:
    sys.exit(__doc__)
try:
    scene = oxl.load(sys.argv[1], max_side=320)
    model = oxl.train(scene, preset="draft", iterations=500)
    quality = oxl.evaluate(model, scene)
    print(f"{len(model)} Gaussians, held-out views: PSNR {quality['psnr']:.2f} dB, SSIM {quality['ssim']:.4f}")
    if len(sys.argv) > 2:
        model.write(sys.argv[2])
except oxl.Error as error:
    sys.exit(str(error))
