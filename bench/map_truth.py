#!/usr/bin/env python3
"""map_truth.py SURVEY MAP - how far MAP/height.tif, of `render --ortho`, is from the truth of a survey of `synth`.

The truth of a pixel is the highest point that SURVEY/truth/depth has in it. Errors are in per cent of the median distance of the ground from
the cameras, in the map's unit: MAP/frame.txt leads from the survey to it. Needs numpy and GDAL's programs (Debian: python3-numpy, gdal-bin). With LIMIT as a third word: exit 1 if the rms is above it.
"""
import json
import os
import subprocess
import sys
import tempfile

import numpy as np


def rotation(q):
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def read_pfm(path):
    with open(path, "rb") as f:
        f.readline()
        width, height = map(int, f.readline().split())
        order = "<f4" if float(f.readline()) < 0 else ">f4"
        return np.frombuffer(f.read(), order).reshape(height, width)[::-1]


def read_heights(folder):
    path = os.path.join(folder, "height.tif")
    info = json.loads(subprocess.check_output(["gdalinfo", "-json", path]))
    with tempfile.TemporaryDirectory() as scratch:
        raw = os.path.join(scratch, "height")
        subprocess.check_call(["gdal_translate", "-q", "-of", "ENVI", path, raw])
        return np.fromfile(raw, "<f4").reshape(info["size"][::-1]), info["geoTransform"]


def lines(path):
    with open(path) as f:
        return [line.split() for line in f if not line.startswith("#")]


def main():
    survey, folder = sys.argv[1:3]
    height, place = read_heights(folder)
    frame = np.array(lines(folder + "/frame.txt"), float)
    unit = np.linalg.norm(frame[0, :3])
    cameras = {c[0]: c for c in lines(survey + "/sparse/0/cameras.txt") if c}
    top = np.full(height.shape, -np.inf)
    distance = []
    for image in lines(survey + "/sparse/0/images.txt")[::2]:
        camera = cameras[image[8]]
        assert camera[1] == "PINHOLE", "synth's cameras are"
        fx, fy, cx, cy = map(float, camera[4:8])
        r, t = rotation(np.array(image[1:5], float)), np.array(image[5:8], float)
        z = read_pfm(f"{survey}/truth/depth/{os.path.splitext(image[9])[0]}.pfm")
        y, x = np.mgrid[0:z.shape[0], 0:z.shape[1]] + 0.5
        p = np.stack([(x - cx) / fx * z, (y - cy) / fy * z, z], -1).reshape(-1, 3)
        p = p[p[:, 2] > 0]
        distance.append(unit * np.median(p[:, 2]))
        p = (p - t) @ r @ frame[:, :3].T + frame[:, 3]
        column = np.floor((p[:, 0] - place[0]) / place[1]).astype(int)
        row = np.floor((p[:, 1] - place[3]) / place[5]).astype(int)
        inside = (column >= 0) & (row >= 0) & (column < height.shape[1]) & (row < height.shape[0])
        np.maximum.at(top, (row[inside], column[inside]), p[inside, 2])
    both = np.isfinite(top) & np.isfinite(height)
    error = np.sort(np.abs(height[both] - top[both])) / np.median(distance)
    rms = 100 * np.sqrt((error ** 2).mean())
    print(f"median {100 * np.median(error):.3f} %, rms {rms:.2f} %, inner 95 % {100 * np.sqrt((error[:int(.95 * len(error))] ** 2).mean()):.2f} %, "
          f"beyond 5 %: {100 * (error > 0.05).mean():.2f} %, no data {100 * (1 - both.sum() / np.isfinite(top).sum()):.1f} %")
    return int(len(sys.argv) > 3 and rms > float(sys.argv[3]))


if __name__ == "__main__":
    sys.exit(main())
