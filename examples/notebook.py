# %% [markdown]
# # Half the Gaussians
# A survey is trained, half of its Gaussians are removed by a rule of one's own, and the rest is refined.
# VS Code, Spyder and PyCharm show these cells as a notebook (the folder "survey" is read); `python3 examples/notebook.py SURVEY` executes
# them in order.

# %%
import pathlib
import sys

import numpy as np

here = pathlib.Path(globals().get("__file__", "examples/x")).resolve().parent
sys.path.insert(0, str(here.parent / "python"))  # not needed after pip install
import oceanxl as oxl

script = sys.argv[1:] if "__file__" in globals() and "ipykernel" not in sys.modules else []  # in an editor argv is its own
scene = oxl.load(script[0] if script else "survey", max_side=320)
losses = []

# %% train
model = oxl.train(scene, iterations=300, callback=lambda p: losses.append(p.loss))
before = oxl.evaluate(model, scene)["psnr"]

# %% look: a held-out image, its render, and where the model is dense
view = next(v for v in scene.views if v.is_test)
image, depth, alpha = oxl.render(model, view)
oxl.write_image("look.png", np.concatenate([view.image, image, np.repeat(alpha[..., None], 3, axis=2)], axis=1))

# %% prune by hand: opacity times the area of the two longest axes says what a Gaussian covers
longest = np.sort(model.scales, axis=1)[:, 1:].sum(axis=1)
cover = np.exp(longest) / (1 + np.exp(-model.opacities))
half = model[cover >= np.median(cover)]
pruned = oxl.evaluate(half, scene)["psnr"]

# %% refine: train the rest further, none is split
refined = oxl.train(scene, iterations=200, start=half, densify_until=0, callback=lambda p: losses.append(p.loss))
after = oxl.evaluate(refined, scene)["psnr"]
print(f"{len(model)} Gaussians: {before:.2f} dB; {len(half)}: {pruned:.2f} dB, refined {after:.2f} dB")

# %% plot
try:
    import matplotlib.pyplot as plt
    plt.plot(losses)
    plt.xlabel("step")
    plt.ylabel("loss, running mean")
    plt.savefig("loss.png")
except ImportError:
    print("loss every 100 steps:", np.round(losses[::100], 4), "(a plot needs matplotlib)")
