"""pip install --no-build-isolation . - builds the shared library by make, and installs it beside python/oceanxl.py. Needs no
network: setuptools, make, a C compiler.

STB=folder and CC are make's; a wheel fits any Python 3 of the machine's kind.
"""
import pathlib
import re
import subprocess

from setuptools import Distribution, setup
from setuptools.command.build_py import build_py

try:
    from wheel.bdist_wheel import bdist_wheel
except ImportError:  # pip installs without a wheel where it cannot make one
    bdist_wheel = None


class Build(build_py):
    def run(self):
        subprocess.run(["make", "build/liboceanxl.so"], check=True)
        target = pathlib.Path(self.build_lib) / "oceanxl"
        self.mkpath(str(target))
        self.copy_file("python/oceanxl.py", str(target / "__init__.py"))
        self.copy_file("build/liboceanxl.so", str(target / "liboceanxl.so"))


class Binary(Distribution):
    def has_ext_modules(self):
        return True


commands = {"build_py": Build}
if bdist_wheel:
    class Wheel(bdist_wheel):
        def get_tag(self):
            return "py3", "none", super().get_tag()[2]
    commands["bdist_wheel"] = Wheel

setup(name="oceanxl", version=re.search(r'#define OXL_VERSION "(.*)"', pathlib.Path("oceanxl.h").read_text()).group(1),
      description="3D Gaussian Splatting of underwater surveys", license="MIT", packages=["oceanxl"], package_dir={"oceanxl": "python"},
      install_requires=["numpy"], cmdclass=commands, distclass=Binary)
