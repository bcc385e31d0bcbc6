#!/usr/bin/python3
"""compact.py OUT.txt... -d DIR - what the tests read of oracle.py's output, in few bytes: DIR/NAME.txt for NAME.out.txt.

    @image    H x 3W   in units of 1e-7
    @fragile  H x 1    a row as W characters, 0 or 1
    @loss, @grad_mean, _quat, _log_scale, _logit_o, _dog, _sh    seven digits
"""
import os
import sys

GRADIENTS = ['grad_mean', 'grad_quat', 'grad_log_scale', 'grad_logit_o', 'grad_dog', 'grad_sh']


def sections(path):
    out, lines = {}, open(path).read().split('\n')
    for i, line in enumerate(lines):
        if line.startswith('@'):
            name, rows, _ = line[1:].split()
            out[name] = [[float(v) for v in row.split()] for row in lines[i + 1:i + 1 + int(rows)]]
    return out


def write(f, name, rows, to_text, between=' '):
    f.write('@%s %d %d\n' % (name, len(rows), len(rows[0]) if between else 1))
    for row in rows:
        f.write(between.join(to_text(v) for v in row) + '\n')


def short(v):
    return ('%.7g' % v).replace('e-0', 'e-').replace('e+0', 'e')


def main():
    folder = sys.argv[sys.argv.index('-d') + 1]
    for path in sys.argv[1:sys.argv.index('-d')]:
        s = sections(path)
        with open(os.path.join(folder, os.path.basename(path).replace('.out.txt', '.txt')), 'w') as f:
            write(f, 'loss', s['loss'], short)
            write(f, 'image', s['image'], lambda v: '%.0f' % (v * 1e7))
            write(f, 'fragile', s['fragile'], lambda v: '%d' % v, '')
            for name in GRADIENTS:
                write(f, name, s[name], short)


main()
