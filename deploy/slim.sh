#!/bin/sh
# Remove from a virtual environment what no service uses while it runs: tests, headers, bytecode, pip, setuptools, AWS
# services other than S3, compilers of networks, encoders of films, and the symbols of shared libraries. Needs binutils; with
# a C compiler the libraries of encoders go too. check_image.py then shows that all of it still works.
#   slim.sh VENV
set -eu
cd "$1"/lib/python3*/site-packages
find . -depth -type d \( -name tests -o -name test \) -exec rm -rf {} +
# Bytecode is as large as the code, and half of it is never loaded: check_image.py writes that of what is.
find . -depth -type d -name __pycache__ -exec rm -rf {} +
# Not all *.pyi: scikit-image reads its own when it is imported.
find . -type f \( -name '*.pxd' -o -name '*.a' -o -name '*.h' -o -name '*.hpp' -o -path './torch/*.pyi' \) -delete
rm -rf torch/include torch/share pip pip-*.dist-info setuptools setuptools-*.dist-info pkg_resources
rm -rf _distutils_hack distutils-precedence.pth
rm -f ../../../bin/pip*
# torch.compile, which nothing here calls, and the algebra that it alone needs.
rm -rf torch/_inductor sympy sympy-*.dist-info mpmath mpmath-*.dist-info ../../../bin/isympy ../../../share/man
# Rich colours Python at most, in a traceback.
[ ! -d pygments/lexers ] ||
  find pygments/lexers -type f -name '*.py' ! -name __init__.py ! -name _mapping.py ! -name python.py ! -name special.py -delete
rm -rf sqlalchemy/testing
# Numbers are written as in the languages of the pages.
[ ! -d babel/locale-data ] || find babel/locale-data -type f ! -name root.dat ! -name en.dat ! -name de.dat -delete
# Sample pictures, and libraries of PyTorch's own tests.
[ ! -d skimage/data ] || find skimage/data -type f ! -name '*.py' ! -name '*.pyi' -delete
rm -f torch/lib/libtorchbind_test.so torch/lib/libjitbackend_test.so torch/lib/libbackend_with_compiler.so
# PyTorch looks for this one when it is imported.
[ ! -d torch/bin ] || find torch/bin -type f ! -name torch_shm_manager -delete
# boto3 asks these for credentials; its other services are 20 MB of descriptions.
[ ! -d botocore/data ] ||
  find botocore/data -mindepth 1 -maxdepth 1 -type d ! -name s3 ! -name sts ! -name 'sso*' ! -name signin -exec rm -rf {} +

# empty LIBRARY: put one of the same name in its place whose functions do nothing and return 0. Others are linked to it,
# so that without it they would not load.
empty() {
  [ -f "$1" ] && command -v gcc >/dev/null || return 0
  version=$(nm -D --defined-only "$1" | sed -n 's/.* [TW] [^@]*@@//p' | head -1)
  nm -D --defined-only "$1" | sed -n 's/.* [TW] \([^@]*\).*/void *\1(void) { return 0; }/p' | sort -u >empty.c
  echo "${version:-NONE} { global: *; };" >empty.map
  gcc -w -fno-builtin -shared -fPIC -nostdlib -Wl,-soname,"${1##*/}" ${version:+-Wl,--version-script=empty.map} -o "$1" empty.c
  rm empty.c empty.map
}
# Films and pictures are decoded, never encoded: x265 and SVT-AV1 are 48 MB. OpenCV's copy of FFmpeg (33 MB) is never called;
# PyAV has its own.
for library in av.libs/libx265-* av.libs/libSvtAv1Enc-* pillow_heif.libs/libx265-* \
  opencv_python_headless.libs/libavcodec-* opencv_python_headless.libs/libavformat-* \
  opencv_python_headless.libs/libavutil-* opencv_python_headless.libs/libswscale-*; do
  empty "$library"
done
if command -v gcc >/dev/null && [ -d opencv_python_headless.libs ]; then  # what only that FFmpeg was linked to
  (cd opencv_python_headless.libs && rm -f libvpx-* libssl-* libcrypto-* libswresample-* libdrm-*)
fi
# OpenBLAS as NumPy and SciPy carry it does not load any more without its symbols.
find . -type f -name '*.so*' ! -path './numpy.libs/*' ! -path './scipy.libs/*' -exec strip --strip-unneeded {} +
