#!/usr/bin/env python3
"""belongs.py PROGRAM [SURVEY...] - do the checks of images, poses and points miss or invent anything?

Prints what `check` warns of: on surveys as they are (given ones, and synth in every mode, with tracks and as
transforms.json without), where it should be nothing; and on damaged copies of each, where it must be something.
Needs python3 with numpy and PIL.
"""
import json, os, random, shutil, subprocess, sys, tempfile
import numpy as np
from PIL import Image, ImageOps

program, given = sys.argv[1], sys.argv[2:]
work = tempfile.mkdtemp()
small = "--max-side 321 --threads 1"

SYNTH = [  # every path, scene, kind of light and of water, and what else synth can do
    "", "--path orbit", "--path forward", "--water none",
    "--water II", "--water 5C", "--water 9C", "--lamp 0", "--lamp 2 --backscatter 0.1", "--lamp 2 --backscatter 0.3 --water 3C",
    "--sand-contrast 0.1", "--sand-contrast 0.3", "--exposure-jitter 1", "--stereo 0.2", "--noise 8",
    "--alpha 1.5", "--origin 400000,5000000,-20", "--points 600", "--lamp 2 --sand-contrast 0.2",
]

def warnings(survey, options=small):
    out = subprocess.run([program, "check", survey] + options.split(), capture_output=True, text=True, errors="replace")
    lines = (out.stderr + out.stdout).splitlines()
    keep = [l for l in lines if "warning:" in l and "training views; expect holes" not in l and "points; check that" not in l]
    if out.returncode: keep.append(f"exit {out.returncode}: " + (lines[0] if lines else ""))
    return keep

# ---------------- a COLMAP model in text, read and written

class Model:
    def __init__(self, survey):
        self.survey, self.folder = survey, os.path.join(survey, "sparse/0")
        read = lambda name: [l.rstrip("\n") for l in open(os.path.join(self.folder, name)) if not l.startswith("#")]
        self.cameras = [l.split() for l in read("cameras.txt") if l.strip()]
        rows = read("images.txt")
        while rows and not rows[-1].strip() and len(rows) % 2: rows.pop()
        self.images = [rows[i].split(None, 9) for i in range(0, len(rows), 2)]
        self.seen = [rows[i + 1] if i + 1 < len(rows) else "" for i in range(0, len(rows), 2)]
        self.points = [l.split() for l in read("points3D.txt") if l.strip()]

    def write(self, tracks=True):
        put = lambda name, lines: open(os.path.join(self.folder, name), "w").write("\n".join(lines) + "\n")
        put("cameras.txt", [" ".join(c) for c in self.cameras])
        put("images.txt", [x for i, s in zip(self.images, self.seen) for x in (" ".join(i), s if tracks else "")])
        put("points3D.txt", [" ".join(p if tracks else p[:8]) for p in self.points])

    def pose(self, i):
        w, x, y, z = np.array([float(v) for v in self.images[i][1:5]])
        r = np.array([[1-2*(y*y+z*z), 2*(x*y-z*w), 2*(x*z+y*w)], [2*(x*y+z*w), 1-2*(x*x+z*z), 2*(y*z-x*w)], [2*(x*z-y*w), 2*(y*z+x*w), 1-2*(x*x+y*y)]])
        m = np.eye(4); m[:3, :3] = r; m[:3, 3] = [float(v) for v in self.images[i][5:8]]
        return m

    def set_pose(self, i, m):
        r = m[:3, :3]; w = np.sqrt(max(0, 1 + np.trace(r))) / 2
        if w > 1e-3: q = [w, (r[2,1]-r[1,2])/4/w, (r[0,2]-r[2,0])/4/w, (r[1,0]-r[0,1])/4/w]
        else:
            v, e = np.linalg.eigh(np.array([[r[0,0]-r[1,1]-r[2,2], r[1,0]+r[0,1], r[2,0]+r[0,2], r[2,1]-r[1,2]], [0, r[1,1]-r[0,0]-r[2,2], r[2,1]+r[1,2], r[0,2]-r[2,0]], [0, 0, r[2,2]-r[0,0]-r[1,1], r[1,0]-r[0,1]], [0, 0, 0, np.trace(r)]]), UPLO="U")
            x = e[:, -1]; q = [x[3], x[0], x[1], x[2]]
        self.images[i][1:8] = ["%.12g" % v for v in list(q) + list(m[:3, 3])]

    def json(self, pose=None, place=None):
        """As transforms.json; pose: camera to world of OpenGL axes to what is written; place: of points."""
        cams, frames = {c[0]: c for c in self.cameras}, []
        for i in range(len(self.images)):
            c = cams[self.images[i][8]]; p = [float(v) for v in c[4:]]
            two = c[1] in ("PINHOLE", "OPENCV"); k = p[2 if two else 1:]
            f = dict(file_path="images/" + self.images[i][9], w=int(c[2]), h=int(c[3]), fl_x=p[0], fl_y=p[1 if two else 0], cx=k[0], cy=k[1])
            if c[1] == "OPENCV": f.update(k1=k[2], k2=k[3], p1=k[4], p2=k[5])
            if c[1] in ("SIMPLE_RADIAL", "RADIAL"): f.update(k1=k[2], k2=k[3] if len(k) > 3 else 0)
            m = np.linalg.inv(self.pose(i)) @ np.diag([1, -1, -1, 1])
            f["transform_matrix"] = (pose(m) if pose else m).tolist()
            frames.append(f)
        xyz = np.array([[float(v) for v in p[1:4]] for p in self.points])
        if place: xyz = np.array([place(x) for x in xyz])
        with open(os.path.join(self.survey, "points.ply"), "w") as out:
            out.write("ply\nformat ascii 1.0\nelement vertex %d\nproperty double x\nproperty double y\nproperty double z\n"
                      "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n" % len(xyz))
            for x, p in zip(xyz, self.points): out.write("%.9g %.9g %.9g %s %s %s\n" % (*x, *p[4:7]))
        json.dump(dict(camera_model="OPENCV", ply_file_path="points.ply", frames=frames), open(os.path.join(self.survey, "transforms.json"), "w"))
        shutil.rmtree(os.path.join(self.survey, "sparse"))

# ---------------- damage

def each_image(m, change, which=None):
    for k, i in enumerate(m.images):
        path = os.path.join(m.survey, "images", i[9])
        if (which is None or k in which) and os.path.exists(path):
            image = Image.open(path).convert("RGB"); size = image.size
            new = change(image)
            (new if new.size == size else new.resize(size)).save(path, **({"quality": 95} if path.lower().endswith(("jpg", "jpeg")) else {}))

def permute(m, order):
    names = [os.path.join(m.survey, "images", i[9]) for i in m.images]
    for n in names: os.rename(n, n + ".old")
    for n, o in zip(names, order): os.rename(names[o] + ".old", n)

def shuffled(m): n = len(m.images); permute(m, [(i + n // 3) % n for i in range(n)])
def renumbered(m): n = len(m.images); permute(m, [(i + 1) % n for i in range(n)])
def exchanged(m):
    n = len(m.images); order = list(range(n)); order[1], order[n // 2] = order[n // 2], order[1]; permute(m, order)
def crop(f):
    def do(image): w, h = image.size; d = f / 2; return image.crop((int(w*d), int(h*d), int(w*(1-d)), int(h*(1-d))))
    return do
def corner(image): w, h = image.size; return image.crop((0, 0, int(w*.8), int(h*.8)))
def barrel(image):
    w, h = image.size; y, x = np.mgrid[0:h, 0:w]; u, v = (x - w/2) / w, (y - h/2) / w; s = 1 + 0.35 * (u*u + v*v)
    px = np.clip((u*s*w + w/2).astype(int), 0, w-1); py = np.clip((v*s*w + h/2).astype(int), 0, h-1)
    return Image.fromarray(np.asarray(image)[py, px])
def shift(image): return Image.fromarray(np.roll(np.asarray(image), image.size[0] // 20, 1))
def bits(m):
    for i in m.images:
        path = os.path.join(m.survey, "images", i[9]); a = np.asarray(Image.open(path).convert("L")).astype(np.uint16) * 16
        Image.fromarray(a).save(path, format="PNG")
def poses(change):
    def do(m):
        for i in range(len(m.images)): m.set_pose(i, change(m.pose(i)))
        m.write()
    return do
def untracked(change):
    def do(m): change(m); Model.write(m, tracks=False)
    return do
transpose = lambda p: np.block([[p[:3, :3].T, p[:3, 3:]], [np.zeros((1, 3)), 1]])
def some(change):  # a fifth of the poses
    left = []
    def do(p): left.append(p); return change(p) if len(left) % 5 == 2 else p
    return do
def some_poses(change):
    def do(m): poses(some(change))(m)
    return do
def xyzw_some(m):
    for i in m.images[::5]: i[1:5] = i[2:5] + [i[1]]
    m.write()
flip, axes = np.diag([1., -1, -1, 1]), np.array([[1., 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
def centre_for_translation(m): out = np.eye(4); out[:3, :3] = m[:3, :3]; out[:3, 3] = np.linalg.inv(m)[:3, 3]; return out
def xyzw(m):
    for i in m.images: i[1:5] = i[2:5] + [i[1]]
    m.write()
def focal(factor):
    def do(m):
        for c in m.cameras:
            for k in range(4, 6 if c[1] in ("PINHOLE", "OPENCV", "OPENCV_FISHEYE") else 5): c[k] = "%.9g" % (float(c[k]) * factor)
        m.write()
    return do
def unit(factor):
    def do(m):
        for p in m.points: p[1:4] = ["%.9g" % (float(v) * factor) for v in p[1:4]]
        m.write()
    return do
def black(m):
    for i in m.images[: max(3, len(m.images) // 8)]:
        path = os.path.join(m.survey, "images", i[9]); image = Image.open(path); Image.new("RGB", image.size).save(path)

DAMAGE = {
    "shuffled": shuffled, "renumbered by one": renumbered, "two exchanged": exchanged,
    "turned 180": lambda m: each_image(m, lambda i: i.rotate(180)),
    "mirrored": lambda m: each_image(m, ImageOps.mirror), "upside down": lambda m: each_image(m, ImageOps.flip),
    "three turned 180": lambda m: each_image(m, lambda i: i.rotate(180), {1, 5, 9}),
    "cropped 10 %": lambda m: each_image(m, crop(.1)), "corner of 80 %": lambda m: each_image(m, corner),
    "distorted": lambda m: each_image(m, barrel), "shifted 5 %": lambda m: each_image(m, shift),
    "negative": lambda m: each_image(m, ImageOps.invert), "an eighth black": black, "12 of 16 bits": bits,
    "poses camera to world": poses(np.linalg.inv), "poses of OpenGL axes": poses(lambda m: flip @ m),
    "centre for translation": poses(centre_for_translation), "quaternion xyzw": xyzw,
    "focal length / 2": focal(.5), "focal length in mm": focal(.01), "points in mm": unit(1000), "points / 10": unit(.1),
    "no tracks, camera to world": untracked(poses(np.linalg.inv)), "no tracks, OpenGL axes": untracked(poses(lambda m: flip @ m)),
    "no tracks, centre": untracked(poses(centre_for_translation)), "no tracks, xyzw": untracked(xyzw),
    "no tracks, focal / 2": untracked(focal(.5)), "no tracks, points x 2": untracked(unit(2)), "no tracks, points in mm": untracked(unit(1000)),
    "no tracks, shuffled": untracked(shuffled), "no tracks, turned 180": untracked(lambda m: each_image(m, lambda i: i.rotate(180))),
    "json, OpenCV axes": lambda m: m.json(lambda p: p @ flip), "json, world to camera": lambda m: m.json(np.linalg.inv),
    "json, points of another frame": lambda m: m.json(place=lambda x: [x[0], x[2], -x[1]]),
    "json, cameras scaled": lambda m: m.json(lambda p: np.array([[*r[:3], r[3] * .1] for r in p[:3]] + [[0, 0, 0, 1]])),
    # of a camera that looks straight down the transposed rotation is the same: no damage in such surveys
    "json, transposed": lambda m: m.json(transpose),
    "json, transposed, OpenCV axes": lambda m: m.json(lambda p: transpose(p @ flip)),
    "json, some OpenCV axes": lambda m: m.json(some(lambda p: p @ flip)), "json, some transposed": lambda m: m.json(some(transpose)),
    "rotation transposed": poses(transpose), "no tracks, rotation transposed": untracked(poses(transpose)),
    "some camera to world": some_poses(np.linalg.inv), "some xyzw": xyzw_some,
    "no tracks, some OpenGL axes": untracked(some_poses(lambda m: flip @ m)),
    "json, y and z of world exchanged": lambda m: m.json(lambda p: axes @ p),
}

def copy(survey):
    to = os.path.join(work, "copy"); shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(survey, to, ignore=shutil.ignore_patterns("truth")); return to

def tell(name, found): print(f"  {name:34s} {'; '.join(w.split('warning: ')[-1][:150] for w in found) or '-'}", flush=True)

surveys = [(s, s) for s in given]
for k, options in enumerate(SYNTH if not os.environ.get("NO_SYNTH") else []):
    to = os.path.join(work, "synth%d" % k)
    subprocess.run([program, "synth", "-o", to, "--views", "20", "--size", "200x136", "--quiet"] + options.split(), check=True, stdout=subprocess.DEVNULL)
    surveys.append((to, "synth " + options))
print("as they are"); alarms = 0
for path, name in surveys if not os.environ.get("ONLY_DAMAGED") else []:
    found = warnings(path); alarms += len(found) > 0; tell(os.path.basename(name), found)
    if os.path.isdir(os.path.join(path, "sparse/0")):
        m = Model(copy(path)); m.write(tracks=False); found = warnings(m.survey); alarms += len(found) > 0; tell("  without tracks", found)
        if all(c[1] in ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL") for c in m.cameras):
            m.json(); found = warnings(m.survey); alarms += len(found) > 0; tell("  as transforms.json", found)
missed = tried = 0
for path, name in surveys[: int(os.environ.get("DAMAGED", len(given) or 4))]:
    if not os.path.isdir(os.path.join(path, "sparse/0")): continue
    print("damaged:", os.path.basename(name)); before = warnings(path)
    for what, change in [d for d in DAMAGE.items() if os.environ.get("ONLY_DAMAGED", "") in d[0]]:
        m = Model(copy(path)); change(m); found = [w for w in warnings(m.survey) if w not in before]
        tried += 1; missed += not found; tell(what, found)
print(f"{alarms} alarms, {missed} of {tried} damaged copies missed"); shutil.rmtree(work)
