// viewer_parts.js - functions of examples/viewer/index.html without a browser: node tests/viewer_parts.js
const fs = require('fs'), path = require('path'), vm = require('vm');
const page = fs.readFileSync(path.join(__dirname, '../examples/viewer/index.html'), 'utf8');
const from = page.indexOf('const PLY_TYPES'), to = page.indexOf('const sigmoid');
const sort = page.slice(page.indexOf('function sortByDepth'), page.indexOf('// ---', page.indexOf('function sortByDepth')));
const context = vm.createContext({Blob, Response, DecompressionStream, TextDecoder, Uint8Array, Float32Array, Uint32Array, DataView, Number, Math, Error});
const spz = page.slice(page.indexOf('async function modelFromSpz'), page.indexOf('function spzRows'));
vm.runInContext(page.slice(from, to) + sort + spz, context);
let failed = 0;
function check(name, is) { console.log((is ? 'ok   ' : 'FAIL ') + name); failed += !is; }
function refuses(text, words) {
    const bytes = new TextEncoder().encode(text).buffer;
    try { const h = context.plyHeader(bytes); if (h.format === 'ascii') context.plyAscii(bytes, h); else context.plyColumns(bytes, h.elements[0], h.start, h.format); }
    catch (e) { return e.message.includes(words); }
    return false;
}
const head = (format, rows, properties) => `ply\nformat ${format} 1.0\nelement vertex ${rows}\n${properties}end_header\n1 2\n`;
check('a short ascii file of many rows is refused', refuses(head('ascii', 2000000000, 'property float x\nproperty float y\n'), 'ends too early'));
check('a short binary file of many rows is refused', refuses(head('binary_little_endian', 2000000000, 'property float x\n'), 'ends too early'));
check('rows without properties are refused', refuses(head('ascii', 2000000000, ''), 'no properties'));
check('a number of rows that is none is refused', refuses(head('ascii', 'many', 'property float x\n'), 'no number of rows'));
const z = [3, 1, 2, -1, 1e30, Infinity, 1.0001, 0.5], means = new Float32Array(z.flatMap(d => [0, 0, d]));
const order = [...context.sortByDepth(means, [0, 0, 1, 0], 0.1)].map(i => z[i]);
check('the farthest is first, whatever lies far away', JSON.stringify(order) === JSON.stringify([Infinity, 1e30, 3, 2, 1.0001, 1, 0.5]) ||
      order.join() === [Infinity, 1e30, 3, 2, 1.0001, 1, 0.5].join());
const cut = require('zlib').gzipSync(Buffer.alloc(5000, 'a few bytes')).subarray(0, 40);
context.modelFromSpz(cut.buffer.slice(cut.byteOffset, cut.byteOffset + 40)).then(() => '', e => e.message).then(message => {
    check('an SPZ that is cut is said to be', message.includes('ends too early'));
    process.exit(failed ? 1 : 0);
});
