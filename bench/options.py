#!/usr/bin/env python3
"""options.py PROGRAM [RUNS [SEED]] - trains a small survey with random options, each anywhere in its range and in any
combination: no number that is not finite, no exit code that is not documented, no crash.

PROGRAM is best a build with sanitizers. Options and ranges come from `train --help all`. Prints each run that breaks
the promise, with the command that repeats it, and a sum. Needs python3 alone.
"""
import json, math, os, random, re, shutil, subprocess, sys, tempfile

program, runs, seed = os.path.abspath(sys.argv[1]), int((sys.argv + [0, 0])[2] or 100), int((sys.argv + [0, 0, 0])[3] or 1)
random.seed(seed)
work = tempfile.mkdtemp()
os.chdir(work)
SKIP = {"images", "sparse", "masks", "from", "block", "device", "backend", "progress", "max-time", "ram",
        "iterations", "force", "dry-run", "help", "json", "restart", "threads", "quiet", "preset", "renders"}
SPECIAL = {  # values that are no number or word of a list
    "ucd": ["off", "on", "auto", "search", "100,100"],
    "keep": ["all", "0.01", "0.5", "1", "5", "100KB", "1"],
    "background": ["auto", "0,0,0", "1,1,1", "0.5,0,1"], "image-cache": ["1", "10K", "1G"], "alpha-min": ["0", "0.05", "1/255"],
}

def options():
    text = subprocess.run([program, "train", "--help", "all"], capture_output=True, text=True).stdout
    found = {}
    for m in re.finditer(r"^  --([a-z0-9-]+)([ =](\S+))?\s", text, re.M):
        if m.group(1) not in SKIP: found[m.group(1)] = m.group(3) or ""
    ranges = dict(re.findall(r"^- `--([a-z0-9-]+)[^`]*`: .*?\(([^()]*(?:to|;)[^()]*)\)\.?", open(docs).read(), re.M)) if os.path.exists(docs) else {}
    return found, ranges

docs = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../docs/OPTIONS.md")

def value(name, form, ranges):
    if name in SPECIAL: return random.choice(SPECIAL[name])
    words = [w for w in form.split("|") if w and not re.search(r"[A-Z0-9.]", w)]
    if words and random.random() < .5 or "|" in form and len(words) == form.count("|") + 1: return random.choice(words)
    lo, hi = 0.0, 1.0
    m = re.search(r"([-0-9.e]+) to ([-0-9.e]+)", ranges.get(name, ""))
    if m: lo, hi = float(m.group(1)), float(m.group(2))
    whole = re.search(r"\b(N|PX|S|COUNT)\b", form) or re.search(r"\d\.\.\d", form)
    if whole: return str(random.choice([0, 1, 2, 3, 7, 50, 1000, 2**31 - 1]) if not m else random.randint(int(lo), int(hi)))
    x = random.choice([lo, hi, random.uniform(lo, hi), max(lo, min(hi, 10 ** random.uniform(-8, 3)))])
    return repr(x)

def finite(path):
    data = open(path, "rb").read(); end = data.index(b"end_header\n") + 11; head = data[:end].decode()
    rows, size = int(re.search(r"element vertex (\d+)", head).group(1)), head.split("element dog")[0].count("property float")
    import array
    a = array.array("f"); a.frombytes(data[end:end + 4 * rows * size])
    return all(map(math.isfinite, a))

found, ranges = options()
subprocess.run([program, "synth", "-o", "s", "--views", "12", "--size", "64x48", "--points", "300", "--water", "5C", "--lamp", "1", "--quiet"], check=True, stdout=subprocess.DEVNULL)
broken, codes = 0, {}
for k in range(runs):
    chosen = random.sample(sorted(found), random.choice([1, 2, 3, 5, 8, 15]))
    command = [program, "train", "s", "-o", "out", "--quiet", "--threads", "1", "--preset", random.choice(["draft", "standard", "paper"]),
               "--iterations", str(random.choice([1, 2, 10, 60, 150])), "--max-gaussians", "1500"]
    for name in chosen: command += ["--" + name] + ([value(name, found[name], ranges)] if found[name] else [])
    shutil.rmtree("out", ignore_errors=True)
    try: done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=300, env={**os.environ, "ASAN_OPTIONS": "exitcode=77"})
    except subprocess.TimeoutExpired: print("TIME", " ".join(command)); broken += 1; continue
    codes[done.returncode] = codes.get(done.returncode, 0) + 1
    why = ""
    if done.returncode not in (0, 2, 3, 4): why = f"exit {done.returncode}"
    elif done.returncode and "fix: " not in done.stderr: why = "no fix"
    elif done.returncode == 0:
        if not finite("out/scene.ply"): why = "not finite"
        if re.search(r"\b(nan|inf)\b", open("out/metrics.json").read() + done.stderr, re.I): why = "nan in metrics.json or log"
        else: json.load(open("out/metrics.json")); json.load(open("out/run.json"))
    if why: broken += 1; print(why, "|", " ".join(command), "|", done.stderr[-600:].replace("\n", " / "), flush=True)
print(f"{runs} runs, exit codes {dict(sorted(codes.items()))}, {broken} broken"); shutil.rmtree(work)
sys.exit(broken > 0)
