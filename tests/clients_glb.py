"""clients_glb.py OURS THEIRS - two KHR_gaussian_splatting files hold the same Gaussians: all arrays, rotations by their covariances."""
import json, struct, sys


def read(path):
    data = open(path, 'rb').read()
    size = struct.unpack_from('<I', data, 12)[0]
    head, bin_at, out = json.loads(data[20:20 + size]), 28 + size, {}
    for name, a in head['meshes'][0]['primitives'][0]['attributes'].items():
        accessor = head['accessors'][a]
        view, width = head['bufferViews'][accessor['bufferView']], {'SCALAR': 1, 'VEC3': 3, 'VEC4': 4}[accessor['type']]
        if accessor['componentType'] != 5126:
            continue  # COLOR_0, for readers without the extension
        at, stride = bin_at + view.get('byteOffset', 0) + accessor.get('byteOffset', 0), view.get('byteStride', 4 * width)
        out[name.split(':')[-1]] = [struct.unpack_from(f'<{width}f', data, at + i * stride) for i in range(accessor['count'])]
    return out


def covariance(q, s):
    x, y, z, w = (v / sum(c * c for c in q) ** 0.5 for v in q)
    r = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    return [sum(r[i][k] * r[j][k] * s[k] * s[k] for k in range(3)) / max(s) ** 2 for i in range(3) for j in range(3)]


ours, theirs = read(sys.argv[1]), read(sys.argv[2])
shape = {k: len(v) for k, v in ours.items()} == {k: len(v) for k, v in theirs.items()}
for a in (ours, theirs):
    a['ROTATION'] = [covariance(q, s) for q, s in zip(a['ROTATION'], a['SCALE'])]
worst = max(abs(x - y) for k in ours for a, b in zip(ours[k], theirs[k]) for x, y in zip(a, b)) if shape else float('inf')
print('ok  ' if worst < 1e-5 else 'FAIL', f'{sys.argv[1]} and {sys.argv[2]}: {len(ours)} arrays, largest difference {worst:.1e}')
sys.exit(not worst < 1e-5)
