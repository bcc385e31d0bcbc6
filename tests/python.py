"""python/oceanxl.py: run by tests/python.sh, with OXL_LIBRARY, from the repository; argument: a folder for files."""
import ctypes
import os
import pathlib
import re
import resource
import signal
import subprocess
import sys

import numpy as np

root, work = pathlib.Path(__file__).resolve().parent.parent, pathlib.Path(sys.argv[1])
sys.path[:0] = [str(root / "python"), str(root / "examples")]
import oceanxl as oxl
import own_loop

scene = oxl.load(work / "survey")
PLAIN = dict(ssim_weight=0, antialias=0, densify_until=0, dropout=0, coarse=0, sh_degree=0, alpha_min=1 / 255, exposure="off", lamp="off", medium="off")


def train(**options):
    return oxl.train(scene, progress=False, **{"iterations": 60, **options})


def address(array):
    return array.__array_interface__["data"][0]


def raises(kind, *words):
    class Raises:
        def __enter__(self):
            pass

        def __exit__(self, got, error, _trace):
            assert got and issubclass(got, kind), f"wanted {kind.__name__}, got {got}"
            assert all(w in str(error) for w in words), f"wanted {words} in: {error}"
            return True
    return Raises()


def test_module_and_header_agree():
    assert subprocess.run([sys.executable, root / "python/generate.py", "check"]).returncode == 0
    sizes = subprocess.run([sys.executable, root / "python/generate.py", "sizes"], capture_output=True, check=True).stdout
    assert sizes.count(b"sizeof") == len(re.findall(r"^typedef struct \w+ {", (root / "oceanxl.h").read_text(), re.M)) > 10
    compiled = ["cc", "-std=c99", "-I", root, "-fsyntax-only", "-x", "c", "-"]
    assert subprocess.run(compiled, input=sizes).returncode == 0
    wrong = sizes.replace(b"offsetof(oxl_model, scale) == ", b"offsetof(oxl_model, scale) == 1")
    assert subprocess.run(compiled, input=wrong, capture_output=True).returncode != 0


def test_a_changed_header_is_noticed():
    text = (root / "oceanxl.h").read_text()
    sys.path.insert(0, str(root / "python"))
    import generate
    changed = text.replace("    int sh_degree;    /* 0..3; planes", "    float sh_degree;    /* 0..3; planes")
    assert changed != text and generate.Header(changed).text() != generate.Header(text).text()


def test_images_and_planes_are_not_copied():
    owned = oxl._Owned(scene.context, oxl.oxl_image, oxl.lib.oxl_image_free)
    scene.context.call(oxl.lib.oxl_scene_image, scene.c, 3, None, ctypes.byref(owned.c))
    image = oxl._image_array(owned)
    assert image.shape == (64, 96, 3) and address(image) == ctypes.cast(owned.c.rgb, ctypes.c_void_p).value
    assert np.array_equal(image, scene.views[3].image)
    doubled = image * 2  # arithmetic keeps the layout
    assert address(oxl._planar(image)) == address(image) and address(oxl._planar(doubled)) == address(doubled)
    model = oxl.Model.create(10, 1)
    assert address(model.means) == ctypes.cast(model.c.plane[0], ctypes.c_void_p).value
    assert address(model.sh[:, 2, 1]) == ctypes.cast(model.c.plane[11 + 3 * 2 + 1], ctypes.c_void_p).value
    model.means[4] = 1, 2, 3
    model.opacities = -2
    assert [model.c.plane[k][4] for k in (0, 1, 2, 10)] == [1, 2, 3, -2]


def test_arrays_keep_their_memory_and_release_it():
    means = train(iterations=3).means
    assert len(scene.points) == 800 and np.isfinite(means).all()
    for _ in range(20):
        scene.views[0].image
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(3000):
        scene.views[0].image  # 74 kB each: 220 MB if they stayed
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20000


def test_models_are_saved_read_and_cut():
    model = train()
    model.save(work / "a.ply")
    again = oxl.Model.read(work / "a.ply", scene)
    assert np.array_equal(again.means, model.means) and np.array_equal(again.sh, model.sh)
    half = model[model.opacities > np.median(model.opacities)]
    assert 0 < len(half) <= len(model) // 2 and np.array_equal(half.scales, model.scales[model.opacities > np.median(model.opacities)])
    assert np.array_equal(half.origin, model.origin)
    model.write(work)
    assert (work / "scene.ply").stat().st_size > 1000


def test_images_depth_and_alpha_are_of_one_surface():
    model = train(iterations=300)
    view = scene.views[3]
    image, depth, alpha = oxl.render(model, view)
    on_white = oxl.render_image(model, view, background=(1, 1, 1))
    black = oxl.render_image(model, view, background=(0, 0, 0))
    assert np.allclose(on_white, black + (1 - alpha)[..., None], atol=1e-5)
    assert 0.5 < alpha.mean() <= 1 and (depth != 0).mean() > 0.5
    means = model.means @ view.pose[2, :3] + view.pose[2, 3]
    assert np.percentile(means, 1) < np.median(abs(depth)) < np.percentile(means, 99)
    rows = {r["view"]: r["psnr"] for r in oxl.evaluate(model, scene, "all")["views"]}
    assert abs(rows[3] - oxl.metrics(image, view.image)["psnr"]) < 1e-6
    moved = oxl.camera(96, 64, view.K, view.pose)
    assert np.array_equal(oxl.render_image(model, moved, background=(0, 0, 0)).shape, (64, 96, 3))


def test_gradients_agree_with_finite_differences():
    model, view = train(), scene.views[3]
    y, x, c = np.mgrid[:64, :96, :3]
    # Smooth: under noise the edges of Gaussians, which no gradient contains, reach a tenth of the slope.
    weight = np.sin(x / 9 + y / 11 + c).astype(np.float32)
    gradient = oxl.render_backward(model, view, weight)
    for name in ("means", "scales", "opacities", "sh"):
        values, exact = getattr(model, name), getattr(gradient, name)
        # Along the thirty steepest numbers at once: one alone may step over the edge of a Gaussian.
        at = np.unravel_index(np.argsort(abs(exact), axis=None)[-30:], exact.shape)
        kept, loss, slope = values[at].copy(), [], abs(exact[at]).sum()
        for step in (1e-3, -1e-3):
            values[at] = kept + step * np.sign(exact[at])
            loss.append(float((oxl.render_image(model, view, imaging=False).astype(float) * weight).sum()))
        values[at] = kept
        assert abs((loss[0] - loss[1]) / 2e-3 / slope - 1) < 0.06, (name, loss, slope)


def test_a_loop_of_ones_own_reaches_the_librarys_psnr():
    order = []
    images = [v.image for v in scene.views]

    def note_view(_rendered, image, _weight):
        order.append(scene.views[int(np.argmin([abs(i - image).mean() for i in images]))])
        return 0, 0
    library = train(iterations=300, start=oxl.Model.from_points(scene), pixels=note_view, **PLAIN)
    own = own_loop.fit(scene, 300, order[:300], **PLAIN)
    psnr = [oxl.evaluate(m, scene)["psnr"] for m in (oxl.Model.from_points(scene), library, own)]
    print(f"     PSNR {psnr[0]:.2f} dB at the start, {psnr[1]:.3f} dB by the library, {psnr[2]:.3f} dB by the loop")
    assert psnr[1] > psnr[0] + 5 and abs(psnr[1] - psnr[2]) < 0.1


def test_terms_and_rules_take_part_in_training():
    plain = train(**PLAIN)
    same = train(pixels=lambda x, y, w: (0, 0), parameters=lambda m, g: 0, **PLAIN)
    assert np.array_equal(plain.means, same.means)

    def no_red(x, _image, _weight):
        gradient = np.zeros_like(x)
        gradient[..., 0] = 10 / x[..., 0].size
        return 10 * x[..., 0].mean(), gradient

    def clearer(model, gradient):
        assert len(model) == len(gradient)
        gradient.opacities[:] += 1
        return 0

    def odd(model, gradient, views, change):
        assert len(change) == len(model) == len(views) and (gradient >= 0).all()
        change[:] = np.where(np.arange(len(model)) < 100, oxl.OXL_KEEP, oxl.OXL_REMOVE)
    assert train(pixels=no_red, **PLAIN).sh[:, 0, 0].mean() < plain.sh[:, 0, 0].mean() - 0.1
    assert train(parameters=clearer, **PLAIN).opacities.mean() < plain.opacities.mean() - 0.5
    assert len(train(density=odd, **dict(PLAIN, densify_until=0.8))) == 100


def test_callbacks_stop_raise_and_see_the_model():
    def stop(p):
        assert p.gaussians == p.model.contents.count
        return p.iteration == 7
    model = train(callback=stop)
    assert (model.iterations, model.finished) == (7, False) and len(model) > 0
    with raises(ZeroDivisionError):
        train(callback=lambda p: 1 / 0)
    with raises(KeyError, "edges"):
        train(pixels=lambda x, y, w: {}["edges"])


def test_ctrl_c_returns_the_model_so_far():
    old = signal.getsignal(signal.SIGINT)
    model = train(callback=lambda p: os.kill(os.getpid(), signal.SIGINT) if p.iteration == 5 else None)
    assert not model.finished and 5 <= model.iterations < 60 and np.isfinite(model.means).all()
    assert signal.getsignal(signal.SIGINT) is old


def test_errors_name_value_and_fix():
    with raises(oxl.Error, "nowhere", "fix"):
        oxl.load("nowhere")
    with raises(TypeError, "iteration", "iterations"):
        train(iteration=5)
    with raises(ValueError, "fast", "draft, standard, paper"):
        train(preset="fast")
    with raises(ValueError, "oxl_train_options.ucd", "maybe"):
        train(ucd="maybe")
    with raises(oxl.Error, "iterations"):
        train(iterations=-1)
    with raises(ValueError, "(64, 96)"):
        oxl.metrics(np.zeros((64, 96)), scene.views[0].image)
    with raises(ValueError, "wanted (64, 96, 3)"):
        oxl.render_backward(oxl.Model.from_points(scene), scene.views[0], np.zeros((3, 3, 3)))
    model = oxl.Model.create(3)
    adam = oxl.Adam(model, scene)
    with raises(oxl.Error, "moments"):
        adam.step(oxl.Model.create(4))


def test_the_seed_and_not_the_threads_decide():
    def scene_of(**options):
        return oxl.load(work / "survey", context=oxl.Context(log=lambda *_: None, **options))
    means = [oxl.train(scene_of(threads=t, seed=s), iterations=20, progress=False).means for t, s in ((1, 1), (2, 1), (1, 2))]
    assert np.array_equal(means[0], means[1]) and not np.array_equal(means[0], means[2])


def test_examples_run():
    for name, wanted in (("train_survey.py", "held-out views: PSNR"), ("own_loop.py", "held-out views: PSNR"), ("notebook.py", "refined")):
        arguments = [work / "survey"] + ([work / "out"] if name == "train_survey.py" else [])
        run = subprocess.run([sys.executable, root / "examples" / name, *arguments], cwd=work, capture_output=True, text=True)
        assert run.returncode == 0 and wanted in run.stdout, run.stdout + run.stderr
        print("     " + run.stdout.strip().splitlines()[-1 if name != "notebook.py" else 0])
    assert (work / "out" / "scene.ply").exists() and (work / "look.png").stat().st_size > 10000


def main():
    passed = failed = 0
    for name, test in list(globals().items()):
        if name.startswith("test_") and any(w in name for w in sys.argv[2:] or [""]):
            try:
                test()
                print(f"ok   {name}", flush=True)
                passed += 1
            except Exception as error:
                import traceback
                traceback.print_exc()
                print(f"FAIL {name}: {error}", flush=True)
                failed += 1
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0)


main()
