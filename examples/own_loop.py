#!/usr/bin/env python3
"""A training loop of one's own, with a loss in numpy: make python, then examples/own_loop.py SURVEY [ITERATIONS].

The loss is the mean absolute error, weighted: 0 where the image is masked. Its gradient in a pixel is the weight times the error's sign
over the image's size. One Gaussian for each of the survey's points moves; none is split or removed.
"""
import pathlib
import sys

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "python"))  # not needed after pip install
import oceanxl as oxl


def fit(scene, iterations, views, **options):
    """Trains on views[i % len(views)] at step i."""
    model = oxl.Model.from_points(scene)
    adam = oxl.Adam(model, scene, iterations=iterations, **options)
    for i in range(iterations):
        view = views[i % len(views)]
        image, weight = view.read()
        weight = 1 if weight is None else weight[..., None]
        error = oxl.render_image(model, view, imaging=False) - image
        adam.step(oxl.render_backward(model, view, weight * np.sign(error) / error.size))
        if (i + 1) % 100 == 0:
            print(f"{i + 1}/{iterations}  loss {abs(weight * error).mean():.4f}")
    return model


if __name__ == "__main__":
    if not 2 <= len(sys.argv) <= 3:
        sys.exit(__doc__)
    survey = oxl.load(sys.argv[1], max_side=320)
    steps = int(sys.argv[2]) if len(sys.argv) > 2 else 500
    order = np.random.default_rng(1)
    views = [v for _ in range(steps // len(survey.training) + 1) for v in order.permutation(survey.training)]
    trained = fit(survey, steps, views)
    print(f"held-out views: PSNR {oxl.evaluate(trained, survey)['psnr']:.2f} dB")
