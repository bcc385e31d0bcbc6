"""python/oceanxl.py: run by tests/python.sh, with OXL_LIBRARY, from the repository; argument: a folder for files."""
import ctypes
import os
import pathlib
import re
import resource
import signal
import subprocess
import sys
import warnings

import numpy as np

root, work = pathlib.Path(__file__).resolve().parent.parent, pathlib.Path(sys.argv[1])
sys.path[:0] = [str(root / "python"), str(root / "examples")]
import generate
import oceanxl as oxl
import own_loop

scene = oxl.load(work / "survey")
other = oxl.load(work / "other")
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


def sizes_in_c():
    """A C program that compiles where C's structs have the sizes of ctypes'."""
    yield '#include "oceanxl.h"'
    for name, fields in generate.Header((root / "oceanxl.h").read_text()).structs.items():
        struct = getattr(oxl, name)
        same = [f"sizeof({name}) == {ctypes.sizeof(struct)}"] + [f"offsetof({name}, {n}) == {getattr(struct, n).offset}" for n, _ in fields]
        yield f"typedef char same_{name}[({' && '.join(same)}) ? 1 : -1];"


def test_module_and_header_agree():
    assert subprocess.run([sys.executable, root / "python/generate.py", "check"]).returncode == 0
    sizes = "\n".join(sizes_in_c()).encode() + b"\n"
    assert sizes.count(b"sizeof") == len(re.findall(r"^typedef struct \w+ {", (root / "oceanxl.h").read_text(), re.M)) > 10
    compiled = ["cc", "-std=c99", "-I", root, "-fsyntax-only", "-x", "c", "-"]
    assert subprocess.run(compiled, input=sizes).returncode == 0
    wrong = sizes.replace(b"offsetof(oxl_model, scale) == ", b"offsetof(oxl_model, scale) == 1")
    assert subprocess.run(compiled, input=wrong, capture_output=True).returncode != 0


def test_a_changed_header_is_noticed():
    text = (root / "oceanxl.h").read_text()
    changed = text.replace("    int sh_degree;    /* 0..3; planes", "    float sh_degree;    /* 0..3; planes")
    assert changed != text and generate.Header(changed).text() != generate.Header(text).text()


def test_images_and_planes_are_not_copied():
    owned = oxl._Owned(scene.context, oxl.oxl_image, oxl.lib.oxl_image_free)
    scene.context.call(oxl.lib.oxl_scene_image, scene.c, 3, None, ctypes.byref(owned.c))
    image, _ = oxl._image_arrays(owned, owned.c)
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
    model = train(medium="off")
    model.save(work / "a.ply")
    again = oxl.Model.read(work / "a.ply", scene)
    assert np.array_equal(again.means, model.means) and np.array_equal(again.sh, model.sh)
    half = model[model.opacities > np.median(model.opacities)]
    assert 0 < len(half) <= len(model) // 2 and np.array_equal(half.scales, model.scales[model.opacities > np.median(model.opacities)])
    assert np.array_equal(half.origin, model.origin)
    model.write(work)
    assert (work / "scene.ply").stat().st_size > 1000


def test_models_with_second_lobes_are_cut():
    copies, view = [], scene.views[3]

    def keep(p):
        assert len(p.model.means) == len(p.model)  # copy must not take this array for all planes
        if p.iteration == 300:
            copies.append((p.model.copy(), oxl.render_image(p.model, view, False)))
    model = train(iterations=300, dog="selective", callback=keep)
    lobes, image = model.lobes, oxl.render_image(model, view, False)
    assert 0 < len(lobes) < len(model) and np.isfinite(lobes).all() and lobes.std() > 0
    for same, wanted in [(model.copy(), image), (model[::-1].copy(), image), *copies]:
        assert np.allclose(oxl.render_image(same, view, False), wanted, atol=1e-4)
    clear = model.copy()
    clear.c.lobes = 0
    assert abs(oxl.render_image(clear, view, False) - image).max() > 1e-3
    mask = np.arange(len(model)) % 3 == 1
    cut = model[mask]
    assert len(cut) == mask.sum() and np.array_equal(cut.lobes, lobes[mask[:len(lobes)]]) and np.array_equal(cut.means, model.means[mask])
    turned = model[[len(model) - 1, 2, 0]]
    assert np.array_equal(turned.means, model.means[[2, 0, len(model) - 1]]) and np.array_equal(turned.lobes, lobes[[2, 0]])
    assert [len(model[i].lobes) for i in (0, -1, slice(0, 0), [])] == [1, 0, 0, 0]
    cut.imaging = None
    cut.save(work / "lobes.ply")
    assert np.allclose(oxl.Model.read(work / "lobes.ply", scene).lobes, cut.lobes)


def test_images_depth_and_alpha_are_of_one_surface():
    model = train(iterations=300)
    view = scene.views[3]
    image, depth, alpha = oxl.render(model, view)
    on_white = oxl.render_image(model, view, imaging=False, background=(1, 1, 1))
    black = oxl.render_image(model, view, imaging=False, background=(0, 0, 0))
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
        assert p.gaussians == len(p.model)
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
    with raises(ValueError, "ucd", "maybe", "off, on, auto, search"):
        train(ucd="maybe")
    with raises(oxl.Error, "iterations"):
        train(iterations=-1)
    with raises(ValueError, "(64, 96)"):
        oxl.metrics(np.zeros((64, 96)), scene.views[0].image)
    with raises(ValueError, "wanted (64, 96, 3)"):
        oxl.render_backward(oxl.Model.from_points(scene), scene.views[0], np.zeros((3, 3, 3)))
    model = oxl.Model.create(3, scene=scene)
    adam = oxl.Adam(model, scene)
    with raises(oxl.Error, "moments"):
        adam.step(oxl.Model.create(4, scene=scene))


def test_what_does_not_fit_is_refused():
    model, created, view = oxl.Model.from_points(scene), oxl.Model.create(3), scene.views[0]
    fitted = train(iterations=10, exposure="on")
    image, K, pose, half = view.image, view.K, view.pose, np.zeros((32, 96))
    no_tests = oxl.load(work / "survey", test_every=0)
    for kind, words, call in [
        (ValueError, ["iterations", "10000000000"], lambda: train(iterations=10**10)),
        (ValueError, ["iterations", "5.5"], lambda: train(iterations=5.5)),
        (oxl.Error, ["iterations"], lambda: oxl.Adam(model, scene, iterations=0)),
        (ValueError, ["split", "test, train, all"], lambda: oxl.evaluate(model, scene, 5)),
        (ValueError, ["preset", "7"], lambda: train(preset=7)),
        (ValueError, ["alpha", "77"], lambda: oxl.load(work / "survey", alpha=77)),
        (ValueError, ["max_side", "0 or more"], lambda: oxl.load(work / "survey", max_side=-5)),
        (ValueError, ["max_side", "'320'"], lambda: oxl.load(work / "survey", max_side="320")),
        (ValueError, ["test_every", "-1 or more"], lambda: oxl.load(work / "survey", test_every=-7)),
        (ValueError, ["image_cache_bytes"], lambda: oxl.load(work / "survey", image_cache_bytes=-1)),
        (ValueError, ["threads"], lambda: oxl.Context(threads=-3)),
        (ValueError, ["seed"], lambda: oxl.Context(seed=-1)),
        (TypeError, ["context", "wanted a Context"], lambda: oxl.load(work / "survey", 320)),
        (ValueError, ["background", "3 finite numbers"], lambda: train(background=(0, 0))),
        (TypeError, ["seed", "Context"], lambda: train(seed=1)),
        (TypeError, ["itterations", "wanted iterations"], lambda: train(itterations=1)),
        (TypeError, ["scene", "'survey'"], lambda: oxl.train("survey")),
        (TypeError, ["start"], lambda: train(start=5)),
        (TypeError, ["model", "wanted a Model"], lambda: oxl.evaluate(scene, model)),
        (TypeError, ["view", "None"], lambda: oxl.render(model, None)),
        (ValueError, ["count", "-1"], lambda: oxl.Model.create(-1)),
        (ValueError, ["origin", "fix: Model.read(path, scene)"], lambda: oxl.evaluate(created, scene)),
        (ValueError, ["origin"], lambda: oxl.render_image(created, view)),
        (ValueError, ["origin"], lambda: train(start=created)),
        (ValueError, ["origin"], lambda: oxl.evaluate(model, other)),
        (ValueError, ["no view", "fix"], lambda: oxl.evaluate(oxl.Model.from_points(no_tests), no_tests)),
        (ValueError, ["uint8", "floats"], lambda: oxl.metrics((image * 255).astype(np.uint8), image)),
        (ValueError, ["weight", "64 x 96"], lambda: oxl.metrics(image, image, half)),
        (ValueError, ["a.jpg", ".png"], lambda: oxl.write_image(work / "a.jpg", image)),
        (ValueError, ["K"], lambda: oxl.camera(96, 64, np.eye(4), pose)),
        (ValueError, ["pose"], lambda: oxl.camera(96, 64, K, pose[:3, :3])),
        (ValueError, ["pose"], lambda: oxl.camera(96, 64, K, pose * np.nan)),
        (ValueError, ["rotation"], lambda: oxl.camera(96, 64, K, pose * [2, 1, 1, 1])),
        (AttributeError, ["opacity"], lambda: setattr(model, "opacity", 3)),
        (TypeError, ["not iterable"], lambda: iter(model)),
        (oxl.Error, ["12", "8", "fix"], lambda: scene.context.call(oxl.lib.oxl_evaluate, ctypes.byref(model.c), other.c, fitted.imaging.c, 0,
                                                                 ctypes.byref(oxl.oxl_metrics()))),
    ]:
        with raises(kind, *words):
            call()
    fitted.c.origin[:] = other.origin
    with raises(ValueError, "imaging", "fix"):
        oxl.render_image(fitted, other.views[0])
    assert not (work / "a.jpg").exists()


def test_words_and_switches_are_taken():
    for options in (dict(sh_degree="auto", densify_every="auto"), dict(stereo="off", antialias="on"), dict(stereo=False, lamp=False), dict(keep="all")):
        train(iterations=2, **options)


def test_imaging_is_written_read_and_kept_by_a_start():
    model = train(iterations=300, medium="on")
    psnr = oxl.evaluate(model, scene)["psnr"]
    for kept in (model, model.copy()):
        kept.write(work / "kept")
        assert (work / "kept" / "scene_clear.ply").exists()
        assert abs(oxl.evaluate(oxl.Model.read(work / "kept", scene), scene)["psnr"] - psnr) < 1e-6
    train(iterations=2, **PLAIN).write(work / "kept")
    assert not (work / "kept" / "imaging.txt").exists()
    model.write(work / "kept")
    for act in (lambda: model.save(work / "kept" / "one.ply"), lambda: oxl.Model.read(work / "kept" / "one.ply")):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            act()
        assert len(said) == 1 and "fix: " in str(said[0].message)
    for start in (model, oxl.Model.read(work / "kept", scene), work / "kept"):
        first = []
        again = train(iterations=100, start=start, callback=lambda p: first.append(p.psnr))
        after = oxl.evaluate(again, scene)["psnr"]
        print(f"     PSNR {psnr:.2f} dB; from it, first step {first[0]:.2f} dB, then {after:.2f} dB")
        assert first[0] > psnr - 6 and after > psnr - 1.5


def test_transparent_images_have_the_models_background():
    for view in scene.views:
        image, weight = view.read()
        weight = np.repeat(np.linspace(0, 1, 96, dtype=np.float32)[None], 64, axis=0)
        path = work / "clear" / "images" / view.name
        path.parent.mkdir(parents=True, exist_ok=True)
        scene.context.call(oxl.lib.oxl_image_write_alpha, os.fsencode(path), ctypes.byref(oxl._image(image, weight)))
    (work / "clear" / "sparse").symlink_to(work / "survey" / "sparse")
    clear = oxl.load(work / "clear", alpha="composite")
    black, white = (clear.views[0].read(background=(g, g, g))[0] for g in (0, 1))
    assert np.array_equal(white, clear.views[0].image) and (white - black)[:, 0].min() > 0.99
    means = [oxl.train(clear, progress=False, iterations=9, background=(0, 0, 0), callback=look).means
             for look in (None, lambda p: clear.views[0].image is None)]
    assert np.array_equal(*means)
    for made in (oxl.Model.from_points(clear), oxl.Model.create(3, scene=clear), oxl.Model.create(3, scene=scene)):
        assert np.allclose(made.background, made.scene is clear)
        assert oxl.evaluate(made, made.scene, "all")["views"][0]["psnr"] == oxl.metrics(oxl.render_image(made, made.scene.views[0]), made.scene.views[0].image)["psnr"]
    made = oxl.Model.create(1, scene=scene)
    made.opacities = -20
    made.background, made.antialias = (0.25, 0.5, 1), True
    assert made.c.antialias == made.c.has_background == 1 and np.allclose(oxl.render_image(made, scene.views[0])[0, 0], (0.25, 0.5, 1))
    assert np.allclose(oxl.render(made, scene.views[0], background=(1, 0, 1)).image[0, 0], (1, 0, 1))


def test_nan_and_too_few_pixels_give_nan():
    image = scene.views[0].image
    hole, few = image.copy(), np.zeros((64, 96))
    hole[3, 4, 1], few[::9, ::9] = np.nan, 1
    for got, names in ((oxl.metrics(hole, image), ("psnr", "cc_psnr", "ssim", "structure")), (oxl.metrics(image, image, few), ("ssim",))):
        assert all(np.isnan(v) == (n in names) for n, v in got.items() if n != "structure"), got
    rows = oxl.evaluate(oxl.Model.from_points(scene), scene)["views"]
    assert isinstance(rows[0]["unshown"], list) and len(rows[0]["unshown"]) == 4


def test_what_a_callback_got_can_be_kept():
    kept, arrays, images = [], [], []

    def note(p):
        kept.append(p)
        arrays.append(p.model.means)
        if p.iteration == 3:
            images.append(oxl.render(p.model, scene.views[0]).image)
            images.append(p.model.copy())

    def pixels(*of):
        arrays.extend(a for a in of if a is not None)
        return 0, 0

    def parameters(model, gradient):
        arrays.extend((model.means, gradient.sh))
        return 0
    model = train(iterations=20, callback=note, pixels=pixels, parameters=parameters)
    assert all(np.isfinite(a).all() for a in arrays) and len({address(a) for a in arrays}) == len(arrays)
    assert [p.iteration for p in kept[:20]] == list(range(1, 21)) and all(p.loss > 0 for p in kept)
    assert {p.stage for p in kept} == ({"model", "viewer"} if model.viewer else {"model"})
    assert images[0].shape == (64, 96, 3) and images[0].std() > 0 and len(images[1]) == kept[2].gaussians
    with raises(AttributeError, "c"):
        kept[-1].model.means


def test_what_a_callback_raises_or_forgets_ends_the_run():
    def log(level, text):
        raise KeyError("log")
    for kind, options in ((TypeError, dict(parameters=lambda m, g: None)), (TypeError, dict(pixels=lambda x, y, w: None)),
                          (TypeError, dict(pixels=lambda x, y, w: (None, 0)))):
        with raises(kind):
            train(**options)
    with raises(KeyError, "log"):
        oxl.train(oxl.load(work / "survey", context=oxl.Context(log=log)), progress=False, iterations=5)


def test_ctrl_c_before_the_first_step_is_raised():
    pressed, steps, old = [], [], signal.getsignal(signal.SIGINT)

    def press(_level, _text):
        if not pressed:
            pressed.append(os.kill(os.getpid(), signal.SIGINT))
    noted = oxl.load(work / "survey", context=oxl.Context(log=press))
    with raises(KeyboardInterrupt):
        oxl.train(noted, callback=steps.append, progress=False)
    assert pressed and not steps and signal.getsignal(signal.SIGINT) is old
    assert oxl.train(noted, iterations=2, progress=False).finished


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
