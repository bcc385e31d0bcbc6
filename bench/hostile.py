#!/usr/bin/env python3
"""hostile.py PROGRAM [KIND...] [--runs N] [--seed S] - faults at run time, against a small survey of `synth`:
kill, signals, full disk, folders that cannot be, links, two processes, a survey that changes, damaged working files.

PROGRAM is best a build with sanitizers. A trial is broken where a run crashes, hangs, ends in a code that is not
documented or without a word, changes a file outside OUT, or says that it finished with other bytes than a run that
nothing disturbed. Prints each broken trial and a sum of each kind. Needs python3 and cmp alone; root for full disks.
"""
import hashlib, os, random, re, shutil, signal, subprocess, sys, tempfile, time
args = sys.argv[1:]

def take(name, default):
    if name not in args:
        return default
    k = args.index(name)
    v = int(args[k + 1])
    del args[k:k + 2]
    return v
runs, seed = (take('--runs', 20), take('--seed', 1))
program, kinds = (os.path.abspath(args[0]), args[1:])
rnd = random.Random(seed)
work = tempfile.mkdtemp(prefix='hostile')
os.chdir(work)
env = {**os.environ, 'ASAN_OPTIONS': 'exitcode=77:detect_leaks=1', 'UBSAN_OPTIONS': 'print_stacktrace=1', 'OMP_NUM_THREADS': '1'}
CODES = (0, 1, 2, 3, 4, 130)
broken, tried, codes = ([], {}, {})
ITER = 120
MODES = {'one': [], 'blocks': ['--blocks', '3'], 'medium': ['--medium', 'on', '--image-cache', '1']}

def command(*a):
    return [program, *map(str, a)]

def train(out, *extra, survey='s'):
    return command('train', survey, '-o', out, '--iterations', ITER, '--threads', 1, '--quiet', *extra)

def fault(kind, name, why, cmd, err):
    broken.append((kind, name, why))
    print(f"BROKEN {kind}: {name}: {why}\n   {' '.join(cmd)}\n   {err[-700:].strip()}", flush=True)

class Ran:

    def __init__(self, cmd, rc, out, err):
        self.cmd, self.rc, self.out, self.err = (cmd, rc, out, err)

def run(cmd, timeout=500, pre=None, **more):
    try:
        p = subprocess.run(cmd, capture_output=True, timeout=timeout, env=env, preexec_fn=pre, stdin=subprocess.DEVNULL, **more)
    except subprocess.TimeoutExpired as e:
        return Ran(cmd, 'timeout', '', (e.stderr or b'').decode(errors='replace'))
    return Ran(cmd, p.returncode, p.stdout.decode(errors='replace'), p.stderr.decode(errors='replace'))

def judge(kind, name, r, allowed=CODES, words=True):
    """Common promises of a process; 1: kept."""
    tried[kind] = tried.get(kind, 0) + 1
    codes.setdefault(kind, {})
    codes[kind][r.rc] = codes[kind].get(r.rc, 0) + 1
    if 'AddressSanitizer' in r.err or 'runtime error' in r.err or 'LeakSanitizer' in r.err:
        fault(kind, name, 'sanitizer', r.cmd, r.err[:3000][-2500:])
        return 0
    if r.rc not in allowed:
        fault(kind, name, f'exit {r.rc}', r.cmd, r.err)
        return 0
    if words and r.rc not in (0, 130) and ('oxl: ' not in r.err):
        fault(kind, name, f'exit {r.rc} without a word', r.cmd, r.err)
        return 0
    if words and r.rc in (2, 3, 4) and ('fix: ' not in r.err):
        fault(kind, name, f'exit {r.rc} without a fix', r.cmd, r.err)
        return 0
    return 1

def read(path):
    try:
        return open(path, 'rb').read()
    except OSError:
        return None

def ply(out):
    return read(out + '/scene.ply')

def finished(out):
    return b'"finished": true' in (read(out + '/run.json') or b'')

def same(kind, name, r, out, mode, survey='s'):
    if r.rc == 0 and ply(out) != ply('ref_' + mode) and ('was trained without' not in r.err):
        fault(kind, name, 'exit 0, other bytes', r.cmd, r.err)
        return 0
    return 1

def tree(folder):
    found = {}
    for at, folders, files in os.walk(folder):
        for f in folders + files:
            p = os.path.join(at, f)
            s = os.lstat(p)
            found[os.path.relpath(p, folder)] = (s.st_mode, os.readlink(p) if os.path.islink(p) else hashlib.md5(read(p)).hexdigest()
                    if os.path.isfile(p) else '')
    return found

def wipe(*paths):
    for p in paths:
        if os.path.islink(p) or os.path.isfile(p):
            os.unlink(p)
        elif os.path.isdir(p):
            shutil.rmtree(p)
        elif os.path.lexists(p):
            os.unlink(p)

def all_files(out):
    return sorted((os.path.relpath(os.path.join(a, f), out) for a, _, fs in os.walk(out) for f in fs))

def setup():
    judge('setup', 'synth', run(command('synth', '-o', 's', '--views', 12, '--size', '96x64', '--points', 800, '--lamp', 0, '--quiet')))
    wipe('s/truth')  # it is somebody's: synth would replace its own
    for m, o in MODES.items():
        judge('setup', m, run(train('ref_' + m, *o)))
    t = time.time()
    run(train('t'))
    global span
    span = time.time() - t
    wipe('t')

def stopped(out, mode, after=None):
    """A run stopped by SIGINT somewhere in its midst, its working files in OUT."""
    wipe(out)
    p = subprocess.Popen(train(out, *MODES[mode]), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=env)
    time.sleep((after or rnd.uniform(0.3, 0.9)) * span * (1.6 if mode != 'one' else 1))
    p.send_signal(signal.SIGINT)
    p.wait()

def kind_kill():
    for k in range(runs):
        mode = rnd.choice(list(MODES))
        wipe('k')
        n = rnd.randint(1, 5)
        for _ in range(n):
            p = subprocess.Popen(train('k', *MODES[mode]), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=env)
            time.sleep(rnd.uniform(0.02, 1.3) * span)
            p.send_signal(signal.SIGINT if rnd.random() < 0.3 else signal.SIGKILL)
            p.wait()
        r = run(train('k', *MODES[mode]))
        name = f'{mode}, {n} times'
        if judge('kill', name, r, (0,)) and same('kill', name, r, 'k', mode):
            left = [f for f in all_files('k') if f.endswith('.tmp') or 'checkpoint' in f]
            if left:
                fault('kill', name, f'left: {left}', r.cmd, r.err)

def kind_signals():
    for k in range(runs):
        mode = rnd.choice(list(MODES))
        wipe('g')
        which = rnd.choice([[signal.SIGINT] * 2, [signal.SIGTERM] * 2, [signal.SIGINT], [signal.SIGTERM], [signal.SIGHUP],
                [signal.SIGINT, signal.SIGTERM], [signal.SIGTERM] * 5])
        p = subprocess.Popen(train('g', *MODES[mode]), stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env)
        time.sleep(rnd.uniform(0.05, 1.1) * span)
        for s in which:
            p.send_signal(s)
            time.sleep(rnd.choice([0, 0, 0.01, 0.1]))
        out, err = p.communicate(timeout=400)
        name = f'{mode}, {[s.name for s in which]}'
        r = Ran(p.args, p.returncode, out.decode(), err.decode(errors='replace'))
        killed = -p.returncode in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) and p.returncode < 0
        if not killed:
            judge('signals', name, r, (0, 130))
        else:
            codes.setdefault('signals', {})
            codes['signals'][p.returncode] = codes['signals'].get(p.returncode, 0) + 1
            print('  note', name, 'ended by the signal', p.returncode)
        if p.returncode == 130 and 'resume' not in r.err and ('again' not in r.err):
            print('  note: no resume line', r.err[-300:])
        r = run(train('g', *MODES[mode]))
        judge('signals', name + ', resumed', r, (0,)) and same('signals', name + ', resumed', r, 'g', mode)
    # other commands, and a closed reader
    for c in OTHERS('ref_one'):
        for s in (signal.SIGINT, signal.SIGTERM):
            wipe('x')
            os.mkdir('x')
            p = subprocess.Popen(c, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env)
            time.sleep(rnd.uniform(0.01, 0.3))
            p.send_signal(s)
            out, err = p.communicate(timeout=400)
            if p.returncode != -s:
                judge('signals', f'{c[1]} {s.name}', Ran(c, p.returncode, '', err.decode(errors='replace')))
            left = [f for f in all_files('x') if f.endswith('.part')]
            if left:
                print('  note left', left)
    for c in [command('check', 's'), command('info', 'ref_one/scene.ply'), command('train', '--help'), command('--man'),
            command('eval', 'ref_one/scene.ply', 's', '--json'), train('pp')]:
        p = subprocess.Popen(['sh', '-c', '"$@" | :; exit ${PIPESTATUS:-0}', 'sh', *c], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                env=env)
        out, err = p.communicate(timeout=400)
        judge('signals', 'closed pipe ' + c[1], Ran(c, p.returncode, '', err.decode(errors='replace')), words=False)
        full = open('/dev/full', 'w')
        p = subprocess.run(c, stdout=full, stderr=subprocess.PIPE, env=env)
        r = Ran(c, p.returncode, '', p.stderr.decode(errors='replace'))
        judge('signals', '/dev/full ' + c[1], r)
        if p.returncode == 0 and c[1] != 'train':
            fault('signals', '/dev/full ' + c[1], 'exit 0 with lost output', c, r.err)
        p = subprocess.run(c, stdout=subprocess.DEVNULL, stderr=full, env=env)
        judge('signals', 'stderr /dev/full ' + c[1], Ran(c, p.returncode, '', ''), words=False)
    wipe('pp')

def OTHERS(model, to='x'):
    return [command('render', model, 's', '-o', to + '/r', '--split', 'all', '--depth'),
            command('render', model, 's', '-o', to + '/o', '--ortho'),
            command('render', model, 's', '-o', to + '/f', '--flight', 'orbit', '--frames', 6),
            *[command('convert', model + '/scene.ply', to + '/scene.' + e) for e in ('spz', 'splat', 'glb', 'ply')],
            command('synth', '-o', to + '/y', '--views', 6, '--size', '96x64', '--points', 300), command('eval', model, 's')]

def kind_disk():
    """A tmpfs of some size, and a limit of file size; afterwards there is room again and the same command ends in the same bytes."""
    os.makedirs('d', exist_ok=True)
    for k in range(runs):
        mode = rnd.choice(list(MODES))
        size = int(2 ** rnd.uniform(2.5, 10.6))
        tmp = rnd.random() < 0.6
        if subprocess.run(['mount', '-t', 'tmpfs', '-o', f'size={size}k,nr_inodes={rnd.choice([0, 0, 0, 8, 20])}', 'tmpfs',
                'd']).returncode:
            print('no tmpfs')
            return
        r = run(train('d/out', *MODES[mode]))
        name = f'{mode}, {size} KB'
        ok = judge('disk', name, r)
        if ok and r.rc == 0 and (ply('d/out') != ply('ref_' + mode) or not finished('d/out')):
            fault('disk', name, 'exit 0, other or unfinished', r.cmd, r.err)
        if ok and r.rc not in (0, 1):
            fault('disk', name, f'exit {r.rc} for a full disk', r.cmd, r.err)
        if ok and r.rc and finished('d/out'):
            fault('disk', name, 'failed and finished', r.cmd, r.err)
        subprocess.run(['mount', '-o', 'remount,size=50m,nr_inodes=0', 'd'])
        r = run(train('d/out', *MODES[mode]))
        judge('disk', name + ', room again', r, (0,)) and same('disk', name + ', room again', r, 'd/out', mode)
        subprocess.run(['umount', 'd'], check=True)
    for c in OTHERS('ref_one', 'd') + [command('report', 'd/ref')]:
        for size in (0, 4, 16, 40, 100, 250):
            subprocess.run(['mount', '-t', 'tmpfs', '-o', 'size=60m', 'tmpfs', 'd'], check=True)
            c2 = c
            if c[1] == 'report':
                shutil.copytree('ref_one', 'd/ref')
                wipe('d/ref/report.html')
            used = int(subprocess.run(['du', '-sk', 'd'], capture_output=True, text=True).stdout.split()[0])
            pad = open('d/pad', 'wb')
            free = os.statvfs('d')
            pad.write(b'0' * max(0, free.f_bavail * free.f_frsize - size * 1024))
            pad.close()
            r = run(c2)
            name = f'{c[1]} {os.path.basename(c[-1])} {size} KB left'
            full = os.statvfs('d').f_bavail * os.statvfs('d').f_frsize
            if judge('disk', name, r) and r.rc == 0 and (c[1] != 'eval'):
                wipe('d/pad')
                first = {f: hashlib.md5(read('d/' + f)).hexdigest() for f in all_files('d') if not f.startswith('ref/')
                        or f.endswith('report.html')}
                q = run(c2)
                again = {f: hashlib.md5(read('d/' + f)).hexdigest() for f in all_files('d') if not f.startswith('ref/')
                        or f.endswith('report.html')}
                if first != again:
                    fault('disk', name, f'exit 0, other files: {[f for f in again if first.get(f) != again[f]]}', c, r.err)
            elif r.rc:
                left = [f for f in all_files('d') if f.endswith(('.tmp', '.part'))]
                if left:
                    fault('disk', name, f'left {left}', c, r.err)
            subprocess.run(['umount', 'd'], check=True)
    import resource
    for k in range(runs // 2):
        mode = rnd.choice(list(MODES))
        size = int(2 ** rnd.uniform(10, 18.5))
        wipe('u')
        lim = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
        r = run(train('u', *MODES[mode]), pre=lim)
        name = f'{mode}, files of {size} bytes'
        judge('disk', name, r, (0, 1))
        r = run(train('u', *MODES[mode]))
        judge('disk', name + ', free', r, (0,)) and same('disk', name + ', free', r, 'u', mode)
    for c in OTHERS('ref_one'):
        for size in (2000, 20000, 100000):
            wipe('x')
            os.mkdir('x')
            judge('disk', f'{c[1]} {c[-1]} files of {size}', run(c, pre=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size,
                    resource.RLIM_INFINITY))), (0, 1))
    for n in (4, 8, 12, 20):
        wipe('u')
        r = run(train('u', *MODES['blocks']), pre=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (n, n)))
        judge('disk', f'{n} file handles', r) and same('disk', f'{n} handles', r, 'u', 'blocks')

def kind_folders():
    before = tree('s')

    def check(name, cmd, allowed=CODES, refuse=True):
        r = run(cmd)
        if judge('folders', name, r, allowed) and refuse and (r.rc == 0):
            fault('folders', name, 'exit 0', cmd, r.err)
        if tree('s') != before:
            fault('folders', name,
                    f"the survey changed: {[k for k in set(tree('s')) | set(before) if tree('s').get(k) != before.get(k)][:6]}", cmd,
                    r.err)
            wipe('s')
            shutil.copytree('keep_s', 's')
    wipe('keep_s')
    shutil.copytree('s', 'keep_s', copy_function=shutil.copy2)
    open('afile', 'w').write('mine\n')
    for out in ('afile', 'afile/x', '/dev/null', '/dev/null/x', '/proc/x', '/nonexistent\x00x'[:12] + '/y', 'a' * 300,
            '/'.join(['b' * 200] * 30)):
        for c in (train(out), command('render', 'ref_one', 's', '-o', out), command('render', 'ref_one', 's', '-o', out, '--ortho'),
                command('synth', '-o', out, '--views', 6, '--size', '96x64', '--points', 300),
                command('convert', 'ref_one/scene.ply', out + '/m.spz')):
            check(f'{c[1]} to {out[:30]!r}', c, refuse='nonexist' not in out)
    if read('afile') != b'mine\n':
        fault('folders', 'afile', 'changed', [], '')
    wipe('/nonexistent', '/nonexisten', '/nonexistenx')
    for out in ('s', 's/', './s/.', 's/images', 's/sparse', 's/sparse/0', 's/images/x', work, '.'):
        for c in (train(out), command('render', 'ref_one', 's', '-o', out),
                command('synth', '-o', out, '--views', 6, '--size', '96x64', '--points', 300),
                command('render', 'ref_one', 's', '-o', out, '--ortho')):
            r = run(c)
            judge('folders', f'{c[1]} to {out}', r)
            now = tree('s')
            lost = [k for k in before if now.get(k) != before[k] and (not (k.startswith('images') and os.path.isdir('s/' + k)))]
            if lost:
                fault('folders', f'{c[1]} to {out}', f'lost {lost[:5]}', c, r.err)
            wipe('s')
            shutil.copytree('keep_s', 's', copy_function=shutil.copy2)
            for f in os.listdir('.'):
                if f not in ('s', 'keep_s', 'afile', 'keep_s') and (not f.startswith('ref_')):
                    wipe(f)
    # a disk that is only to be read
    os.makedirs('d', exist_ok=True)
    subprocess.run(['mount', '-t', 'tmpfs', '-o', 'size=30m', 'tmpfs', 'd'], check=True)
    shutil.copytree('ref_one', 'd/done')
    stopped('part', 'one')
    shutil.copytree('part', 'd/part')
    os.mkdir('d/empty')
    shutil.copytree('s', 'd/s')
    subprocess.run(['mount', '-o', 'remount,ro', 'd'], check=True)
    part = [] if finished('d/part') else [train('d/part')]
    for c in (train('d/empty'), train('d/new'), *part, train('d/done', '--restart'), command('report', 'd/done'),
            command('render', 'ref_one', 's', '-o', 'd/empty'), command('convert', 'ref_one/scene.ply', 'd/m.spz'),
            train('d/done', '--iterations', 200), command('synth', '-o', 'd/s', '--views', 6)):
        check(f"read-only {' '.join(c[1:4])}", c, (1, 2, 3))
    for c in (command('eval', 'd/done', 'd/s'), command('render', 'd/done', 'd/s', '-o', 'x'), train('x2', survey='d/s'),
            command('info', 'd/done/scene.ply'), command('check', 'd/s'), train('d/done')):
        r = run(c)
        judge('folders', f"read from read-only {' '.join(c[1:4])}", r, (0,))
    subprocess.run(['umount', 'd'], check=True)
    wipe('x', 'x2', 'part', 'd')

def kind_links():
    """Each name of a run as a link (to a file, to a folder, to nothing) or a second hard link to a file outside."""
    for mode in ('one', 'blocks'):
        names = set(all_files('ref_' + mode)) | {'.lock', 'blocks/.lock', 'report.html.part', 'renders/.renders'}
        stopped('part', mode)
        names |= set(all_files('part'))
        names |= {os.path.dirname(n) for n in names} - {''}
        for name in sorted(names):
            for form in ('link', 'hard', 'nothing', 'folder', 'loop'):
                for start in ('done', 'part', 'new'):
                    if rnd.random() > runs / 100:
                        continue
                    wipe('v', 'l')
                    os.makedirs('v/in')
                    open('v/file', 'w').write('keep')
                    open('v/in/photo', 'w').write('keep')
                    os.chmod('v/file', 0o600)
                    before = tree('v')
                    if start == 'done':
                        shutil.copytree('ref_' + mode, 'l')
                    elif start == 'part':
                        shutil.copytree('part', 'l')
                    os.makedirs(os.path.dirname('l/' + name), exist_ok=True)
                    wipe('l/' + name)
                    if form == 'hard':
                        os.link('v/file', 'l/' + name)
                    else:
                        os.symlink({'link': work + '/v/file', 'nothing': work + '/v/none', 'folder': work + '/v/in',
                                'loop': os.path.basename(name)}[form], 'l/' + name)
                    if start == 'done' and name in ('run.json',):
                        pass
                    c = train('l', *MODES[mode], *(['--restart'] if start == 'done' else []))
                    r = run(c)
                    what = f'{mode} {start} {name} {form}'
                    if not judge('links', what, r):
                        continue
                    if tree('v') != before:
                        fault('links', what, 'a file outside changed', c, r.err)
                    if r.rc == 0:
                        same('links', what, r, 'l', mode)
    for c in OTHERS('ref_one', 'l'):
        wipe('l', 'v')
        os.mkdir('l')
        run(c)
        made = all_files('l')
        for name in made:
            for form in ('link', 'hard', 'nothing'):
                if rnd.random() > runs / 50:
                    continue
                wipe('l', 'v')
                os.makedirs('v')
                open('v/file', 'w').write('keep')
                before = tree('v')
                os.makedirs(os.path.dirname('l/' + name), exist_ok=True)
                if form == 'hard':
                    os.link('v/file', 'l/' + name)
                else:
                    os.symlink({'link': work + '/v/file', 'nothing': work + '/v/none'}[form], 'l/' + name)
                r = run(c)
                what = f'{c[1]} {name} {form}'
                judge('links', what, r)
                if tree('v') != before:
                    fault('links', what, 'a file outside changed', c, r.err)
    wipe('l', 'v')

def kind_together():
    for k in range(runs):
        mode = rnd.choice(list(MODES))
        wipe('t2')
        a = train('t2', *MODES[mode])
        b = rnd.choice([a, train('t2', '--seed', 9), train('t2', '--restart'), command('render', 't2', 's', '-o', 't2/renders'),
                command('report', 't2'), command('convert', 't2/scene.ply', 't2/scene.spz'), command('eval', 't2', 's'),
                train('t2/blocks/000'), train('t2', *MODES[mode], '--block', '1'),
                command('render', 't2', 's', '-o', 't2', '--ortho')])
        p = subprocess.Popen(a, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env)
        time.sleep(rnd.uniform(0, 0.9) * span)
        r2 = run(b)
        out, err = p.communicate(timeout=500)
        r1 = Ran(a, p.returncode, '', err.decode(errors='replace'))
        name = f"{mode} beside {' '.join(b[1:4])}"
        judge('together', name + ' (first)', r1)
        judge('together', name + ' (second)', r2)
        if r1.rc == 0 and b[1] == 'train' and ('--seed' not in b):
            same('together', name, r1, 't2', mode)
        r = run(a)
        if '--seed' not in b and '--block' not in b:
            judge('together', name + ', again', r) and same('together', name + ', again', r, 't2', mode)
    for c in OTHERS('ref_one'):
        for k in range(2):
            wipe('x')
            os.mkdir('x')
            ps = [subprocess.Popen(c, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env) for _ in range(3)]
            for p in ps:
                out, err = p.communicate(timeout=400)
                judge('together', f'3 x {c[1]} {c[-1]}', Ran(c, p.returncode, '', err.decode(errors='replace')))
            first = {f: read('x/' + f) for f in all_files('x')}
            run(c)
            if first != {f: read('x/' + f) for f in all_files('x')}:
                fault('together', f'3 x {c[1]}', 'other files than of one', c, '')

def change(survey, how):
    f = f'{survey}/images/' + rnd.choice(sorted(os.listdir(f'{survey}/images')))
    data = read(f) if os.path.isfile(f) else b'x'
    if how == 'vanish':
        wipe(f)
    elif how == 'all vanish':
        os.rename(f'{survey}/images', f'{survey}/gone')
    elif how == 'truncated':
        open(f, 'wb').write(data[:len(data) * rnd.randint(0, 9) // 10])
    elif how == 'replaced':
        shutil.copyfile(f'{survey}/images/' + sorted(os.listdir(f'{survey}/images'))[0], f + '.x')
        os.rename(f + '.x', f)
    elif how == 'other size':
        os.rename(shutil.copy('other.png', f + '.x'), f)
    elif how == 'bytes':
        d = bytearray(data)
        [d.__setitem__(rnd.randrange(len(d)), rnd.randrange(256)) for _ in range(5)] if d else 0
        open(f, 'wb').write(d)
    elif how == 'folder':
        wipe(f)
        os.mkdir(f)
    elif how == 'pipe':
        wipe(f)
        os.mkfifo(f)
    elif how == 'zero':
        wipe(f)
        os.symlink('/dev/zero', f)
    elif how == 'points':
        p = survey + '/sparse/0/points3D.txt'
        d = read(p)
        open(p, 'wb').write(d[:len(d) // 2])
    elif how == 'poses':
        p = survey + '/sparse/0/images.txt'
        d = read(p)
        open(p, 'wb').write(d.replace(b'0', b'1'))
    elif how == 'survey gone':
        os.rename(survey, survey + '_gone')

def kind_changes():
    run(command('synth', '-o', 'os', '--views', 6, '--size', '64x48', '--points', 300, '--quiet'))
    shutil.copy('os/images/' + sorted(os.listdir('os/images'))[0], 'other.png')
    hows = ['vanish', 'all vanish', 'truncated', 'replaced', 'other size', 'bytes', 'folder', 'pipe', 'zero', 'points', 'poses',
            'survey gone']
    for k in range(runs * 2):
        how, mode = (hows[k % len(hows)], rnd.choice(list(MODES)))
        wipe('c', 'c_gone', 'co')
        shutil.copytree('s', 'c', copy_function=shutil.copy2)
        c = train('co', *MODES[mode], '--image-cache', rnd.choice(['1', '1', '30K', '1G']), survey='c')
        p = subprocess.Popen(c, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env)
        time.sleep(rnd.uniform(0.02, 0.9) * span)
        n = 1 if how in ('all vanish', 'survey gone') else rnd.choice([1, 1, 6])
        try:
            [change('c', how) for _ in range(n)]
        except OSError:
            pass
        try:
            out, err = p.communicate(timeout=500)
        except subprocess.TimeoutExpired:
            p.kill()
            out, err = p.communicate()
            fault('changes', f'{mode} {how}', 'hangs', c, err.decode(errors='replace'))
            continue
        r = Ran(c, p.returncode, '', err.decode(errors='replace'))
        name = f'{mode} {how} x {n}'
        judge('changes', name, r)
        if r.rc == 0 and ply('co') != ply('ref_' + mode) and ('warning' not in r.err):
            fault('changes', name, 'finished with other bytes, no word', c, r.err)
        if r.rc and finished('co'):
            fault('changes', name, 'failed and finished', c, r.err)
        if r.rc == 0 and how == 'all vanish' and (ply('co') != ply('ref_' + mode)):
            fault('changes', name, 'finished with other bytes', c, r.err)
        wipe('c')
        wipe('c_gone')
        shutil.copytree('s', 'c', copy_function=shutil.copy2)
        if r.rc:
            r = run(c)
            judge('changes', name + ', put back', r) and same('changes', name + ', put back', r, 'co', mode)
        for cc in [command('eval', 'ref_one', 'c'), command('render', 'ref_one', 'c', '-o', 'x'), command('check', 'c')]:
            if rnd.random() < 0.1:
                p = subprocess.Popen(cc, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env)
                time.sleep(rnd.uniform(0, 0.2))
                try:
                    change('c', how)
                except OSError:
                    pass
                try:
                    out, err = p.communicate(timeout=400)
                    judge('changes', f'{cc[1]} {how}', Ran(cc, p.returncode, '', err.decode(errors='replace')))
                except subprocess.TimeoutExpired:
                    p.kill()
                    p.communicate()
                    fault('changes', f'{cc[1]} {how}', 'hangs', cc, '')
    wipe('c', 'co', 'x')

def damage(path, how):
    if how == 'gone':
        wipe(path)
        return
    if how == 'folder':
        wipe(path)
        os.mkdir(path)
        return
    d = bytearray(read(path))
    if how == 'empty':
        d = bytearray()
    elif how == 'half':
        d = d[:len(d) // 2]
    elif how == 'short':
        d = d[:-1]
    elif how == 'long':
        d += bytes((rnd.randrange(256) for _ in range(50)))
    elif how == 'bit' and d:
        d[rnd.randrange(len(d))] ^= 1 << rnd.randrange(8)
    elif how == 'digit':
        at = [i for i, c in enumerate(d[:20000]) if 48 <= c <= 57]
        if at:
            d[rnd.choice(at)] = rnd.choice(b'0123456789-e.')
    elif how == 'noise' and d:
        i = rnd.randrange(len(d))
        d[i:i + 64] = bytes((rnd.randrange(256) for _ in range(len(d[i:i + 64]))))
    elif how == 'zeros' and d:
        i = rnd.randrange(len(d))
        d[i:i + 300] = bytes(len(d[i:i + 300]))
    elif how == 'random':
        d = bytearray((rnd.randrange(256) for _ in range(len(d))))
    elif how == 'huge number':
        d = bytearray(re.sub(b'\\d+', lambda m: b'99999999999999999999' if rnd.random() < 0.1 else m.group(0),
                bytes(d[:20000]))) + d[20000:]
    open(path, 'wb').write(d)
HOWS = ['gone', 'folder', 'empty', 'half', 'short', 'long', 'bit', 'bit', 'bit', 'digit', 'digit', 'noise', 'zeros', 'random',
        'huge number']

def kind_files():
    for k in range(runs * 4):
        mode = rnd.choice(list(MODES))
        if k % 6 == 0 or k < 1:
            pass
        stopped('part', mode) if rnd.random() < 0.8 else (wipe('part'), shutil.copytree('ref_' + mode, 'part'))
        names = [f for f in all_files('part') if not f.endswith('.png')]
        if not names:
            continue
        name, how = (rnd.choice(names), rnd.choice(HOWS))
        if rnd.random() < 0.5:
            name = rnd.choice([f for f in names if re.search('checkpoint|imaging.txt|json$|partition', f)]
                    or names)
        damage('part/' + name, how)
        was_done = finished('part')
        c = train('part', *MODES[mode])
        r = run(c)
        what = f"{mode} {('done' if was_done else 'part')} {name} {how}"
        if not judge('files', what, r):
            continue
        if r.rc == 0 and name != 'scene.ply' and (not was_done):
            same('files', what, r, 'part', mode)
        for cc in [command('eval', 'part', 's'), command('render', 'part', 's', '-o', 'x'), command('report', 'part'),
                command('info', 'part/scene.ply'), command('convert', 'part/scene.ply', 'y.spz'),
                command('render', 'part', 's', '-o', 'x', '--ortho')]:
            if rnd.random() < 0.3:
                judge('files', f'{what}: {cc[1]}', run(cc))
    for k in range(runs * 4):
        mode = rnd.choice(list(MODES))
        wipe('part')
        shutil.copytree('ref_' + mode, 'part')
        names = [f for f in all_files('part') if not f.endswith('.png')]
        name, how = (rnd.choice([f for f in names if '/' not in f] or names if rnd.random() < 0.7 else names), rnd.choice(HOWS))
        damage('part/' + name, how)
        for cc in [command('eval', 'part', 's'), command('render', 'part', 's', '-o', 'x'), command('report', 'part'),
                command('convert', 'part/scene.ply', 'y.spz'), command('render', 'part', 's', '-o', 'x', '--ortho'),
                train('part', *MODES[mode]), train('part', *MODES[mode], '--iterations', ITER + 40),
                train('z', '--from', 'part')]:
            if rnd.random() < 0.4:
                judge('files', f'reader, {mode} {name} {how}: {cc[1]}', run(cc))
                wipe('z')
    wipe('part', 'x', 'y.spz')
setup()
for name in kinds or ['kill', 'signals', 'disk', 'folders', 'links', 'together', 'changes', 'files']:
    t = time.time()
    globals()['kind_' + name]()
    ends, faults = dict(sorted(codes.get(name, {}).items(), key=str)), sum((b[0] == name for b in broken))
    print(f'{name}: {tried.get(name, 0)} processes judged, exit codes {ends}, {faults} broken, {time.time() - t:.0f} s', flush=True)
subprocess.run('umount d 2>/dev/null', shell=True)
os.chdir('/')
shutil.rmtree(work)
sys.exit(bool(broken))
