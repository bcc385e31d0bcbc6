// clients.mjs FILE... - gsplat reads each; its count, places and sizes are those of FILE.json (oceanxl info --json).
import {readFileSync} from 'node:fs';
globalThis.window ??= globalThis;
globalThis.self ??= globalThis;
const gsplat = await import('gsplat');

const middle = values => values.sort((a, b) => a - b)[Math.floor(values.length / 2)];

for (const file of process.argv.slice(2)) {
    const bytes = readFileSync(file), buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
    const wanted = JSON.parse(readFileSync(file + '.json', 'utf8')), loader = file.endsWith('.ply') ? gsplat.PLYLoader : gsplat.Loader;
    const {vertexCount, positions, scales} = loader.LoadFromArrayBuffer(buffer, new gsplat.Scene()).data;
    const faults = [];
    if (vertexCount !== wanted.gaussians) faults.push(`${vertexCount} Gaussians, wanted ${wanted.gaussians}`);
    ['x', 'y', 'z', 'scale_0', 'scale_1', 'scale_2'].forEach((name, k) => {
        const plane = k < 3 ? positions : scales, seen = middle(Array.from({length: vertexCount}, (_, i) => plane[3 * i + k % 3]));
        if (!(Math.abs(seen - wanted[name][1]) <= 1e-4 * Math.abs(wanted[name][1]) + 1e-5)) faults.push(`median ${name} ${seen}, wanted ${wanted[name][1]}`);
    });
    console.log(faults.length ? 'FAIL' : 'ok  ', 'gsplat reads', file, ...faults);
    if (faults.length) process.exitCode = 1;
}
