#!/usr/bin/python3
"""compact.py scenes/NAME.txt... -o OUT -d DIR - what the tests read of oracle.py's input and output, in the library's terms: DIR/NAME.txt.

Numbers alone, in this order (planes and rows as in oxl_model, rows with a second lobe first):

    width height degree count lobes loss seed ste    loss: 0 dot, 1 l1, 2 l2, 3 l1dssim; ste: of clamp_grad
    fx fy cx cy near, the pose's rotation (9) and translation (3), the background (3)
    the planes; their positions are from the mean of the positions, which the translation has
    the expected loss, image (H, W, 3) in units of 1e-7, fragile pixels (H, W) as 0 or 1, and the gradient of each plane

The oracle's second lobes have an opacity and scales of their own, the library's are factors of the Gaussian's: o' = o sigmoid(a), s' = s exp(b).
What pulls at log o' = log o + log sigmoid(a) is dL/d(logit o') / (1 - o'); it pulls at logit o with 1 - o, and at a with 1 - sigmoid(a). What
pulls at log s' = log s + b pulls at both.
"""
import math
import os
import sys

LOSSES = ['dot', 'l1', 'l2', 'l1dssim']
ROTATION, LOG_SCALE, LOGIT, LOBED, LOBE, SH = 3, 7, 10, 11, 12, 16  # columns of the scene's rows


def sections(path):
    out, lines = {}, open(path).read().split('\n')
    for i, line in enumerate(lines):
        if line.startswith('@'):
            name, rows, _ = line[1:].split()
            out[name] = [[float(v) for v in row.split()] for row in lines[i + 1:i + 1 + int(rows)]]
    return out


def scene(path):
    words = ' '.join(line.split('#')[0] for line in open(path)).split()
    out = {}
    sizes = {'image': 2, 'intrinsics': 4, 'pose': 7, 'background': 3, 'sh_degree': 1, 'near': 1, 'clamp_grad': 1, 'dog_alpha': 1, 'loss': 2}
    while words:
        key = words.pop(0)
        if key == 'gaussians':
            count, columns = int(words.pop(0)), SH + 3 * (int(out['sh_degree'][0]) + 1) ** 2
            numbers = [float(w) for w in words]
            out['rows'] = [numbers[i * columns:(i + 1) * columns] for i in range(count)]
            words = []
        else:
            out[key], words = words[:sizes[key]], words[sizes[key]:]
    return out


def rotation(q):
    n = math.sqrt(sum(x * x for x in q))
    w, x, y, z = (v / n for v in q)
    return [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]


def factor(x, y):
    """logit of o'/o = (1 + e^-x) / (1 + e^-y), of the logits x of o and y of o'; at most 40, where it is 1"""
    rest = math.exp(-y) - math.exp(-x)  # (1 - o'/o) (1 + e^-y)
    return min(40, math.log((1 + math.exp(-x)) / rest)) if rest > 0 else 40


def sigmoid(x):
    return 1 / (1 + math.exp(-x)) if x >= 0 else math.exp(x) / (1 + math.exp(x))


def planes(rows, origin):
    out = [[r[a] - origin[a] for r in rows] for a in range(3)]
    for k in list(range(LOG_SCALE, LOGIT)) + list(range(ROTATION, LOG_SCALE)) + [LOGIT] + list(range(SH, len(rows[0]))):
        out.append([r[k] for r in rows])
    lobed = [r for r in rows if r[LOBED]]
    out.append([factor(r[LOGIT], r[LOBE]) for r in lobed])
    for a in range(3):
        out.append([r[LOBE + 1 + a] - r[LOG_SCALE + a] for r in lobed])
    return out


def gradients(rows, order, s):
    sh = len(s['grad_sh'][0])
    e = {name: [s[name][i] for i in order] for name in ['grad_mean', 'grad_log_scale', 'grad_quat', 'grad_logit_o', 'grad_sh', 'grad_dog']}
    out = [[r[k] for r in e[name]] for name, columns in
           [('grad_mean', 3), ('grad_log_scale', 3), ('grad_quat', 4), ('grad_logit_o', 1), ('grad_sh', sh)] for k in range(columns)]
    lobes = sum(1 for r in rows if r[LOBED])
    dog = [[r[k] for r in e['grad_dog'][:lobes]] for k in range(4)]
    for i in range(lobes):
        x, y, pull = rows[i][LOGIT], rows[i][LOBE], dog[0][i]
        out[10][i] += pull * sigmoid(-x) / sigmoid(-y)
        dog[0][i] = pull * (1 - math.exp(y - x))
        for a in range(3):
            out[3 + a][i] += dog[1 + a][i]
    return out + dog


def line(values, form='%.17g'):
    return ' '.join(form % v for v in values) + '\n'


def main():
    out, folder = sys.argv[sys.argv.index('-o') + 1], sys.argv[sys.argv.index('-d') + 1]
    for path in sys.argv[1:sys.argv.index('-o')]:
        name = os.path.basename(path)[:-4]
        c, s = scene(path), sections(os.path.join(out, name + '.out.txt'))
        order = sorted(range(len(c['rows'])), key=lambda i: not c['rows'][i][LOBED])
        rows = [c['rows'][i] for i in order]
        origin = [sum(r[a] / len(rows) for r in c['rows']) for a in range(3)]
        pose = [float(v) for v in c['pose']]
        turn = rotation(pose[:4])
        move = [pose[4 + r] + sum(turn[3 * r + a] * origin[a] for a in range(3)) for r in range(3)]
        lobes = sum(1 for r in rows if r[LOBED])
        with open(os.path.join(folder, name + '.txt'), 'w') as f:
            f.write('%s %s %s %d %d %d %s %d\n' % (*c['image'], c['sh_degree'][0], len(rows), lobes, LOSSES.index(c['loss'][0]), c['loss'][1],
                                                   c['clamp_grad'][0] == 'ste'))
            f.write(' '.join(c['intrinsics'] + c.get('near', ['0.2'])) + '\n' + line(turn) + line(move) + ' '.join(c['background']) + '\n')
            for k, p in enumerate(planes(rows, origin)):
                f.write(line(p, '%.17g' if k < 3 else '%.12g'))
            f.write(line(s['loss'][0], '%.7g'))
            for r in s['image']:
                f.write(line([v * 1e7 for v in r], '%.0f'))
            for r in s['fragile']:
                f.write(line(r, '%d'))
            for p in gradients(rows, order, s):
                f.write(line(p, '%.8g'))


main()
