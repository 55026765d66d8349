#!/bin/sh
# Remove from a virtual environment what no service uses while it runs: tests, headers, pip, setuptools, AWS services other
# than S3, and the symbols of shared libraries. Needs binutils.
#   slim.sh VENV
set -eu
cd "$1"/lib/python3*/site-packages
find . -depth -type d \( -name tests -o -name test \) -exec rm -rf {} +
# Not *.pyi: scikit-image reads its own when it is imported.
find . -type f \( -name '*.pxd' -o -name '*.a' -o -name '*.h' -o -name '*.hpp' \) -delete
rm -rf torch/include torch/share pip pip-*.dist-info setuptools setuptools-*.dist-info pkg_resources
rm -rf _distutils_hack distutils-precedence.pth
rm -f ../../../bin/pip*
# PyTorch looks for this one when it is imported.
[ ! -d torch/bin ] || find torch/bin -type f ! -name torch_shm_manager -delete
# boto3 asks these for credentials; its other services are 20 MB of descriptions.
[ ! -d botocore/data ] ||
  find botocore/data -mindepth 1 -maxdepth 1 -type d ! -name s3 ! -name sts ! -name 'sso*' ! -name signin -exec rm -rf {} +
# OpenBLAS as NumPy and SciPy carry it does not load any more without its symbols.
find . -type f -name '*.so*' ! -path './numpy.libs/*' ! -path './scipy.libs/*' -exec strip --strip-unneeded {} +
