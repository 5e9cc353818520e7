#!/bin/sh
# Make .venv and install leadline in it for development; called by the Makefile as: tools/install.sh [PYTHON]
# The optional part, SuiteSparse and the packages that bind it, may fail: that is said, and the `lu` solver remains.
set -eu

python=${1:-python3}
packages="libsuitesparse-dev libopenblas0"

say() { printf '%s\n' "install: $*"; }

loudly() {
    printf '\n%s\n' "**********************************************************************" >&2
    printf '%s\n' "$@" >&2
    printf '%s\n\n' "**********************************************************************" >&2
}

have() { command -v "$1" >/dev/null 2>&1; }

# 0 if a file named $1 lies in one of the folders where SuiteSparse's headers are usually found
header() {
    for folder in /usr/include /usr/local/include /opt/homebrew/include ${CONDA_PREFIX:+"$CONDA_PREFIX/include"} \
        ${SUITESPARSE_INCLUDE_DIR:+"$SUITESPARSE_INCLUDE_DIR"}; do
        if [ -e "$folder/suitesparse/$1" ] || [ -e "$folder/$1" ]; then return 0; fi
    done
    return 1
}

# Only Linux distributions leave CHOLMOD on the slow reference BLAS; conda and Homebrew bring a fast one with it.
openblas() {
    have apt-get || return 0
    if [ -e "${CONDA_PREFIX:-}/include/suitesparse/cholmod.h" ]; then return 0; fi
    PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null | grep -q libopenblas
}

compiler() { have "${CC:-cc}" || have gcc; }

python_header() { [ -e "$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h" ]; }

# The Debian packages that are missing, on one line
missing() {
    if ! header cholmod.h || ! header SuiteSparseQR_C.h || ! openblas; then printf '%s ' "$packages"; fi
    if ! compiler; then printf '%s ' "gcc libc6-dev"; fi
    if ! python_header; then printf '%s ' "python3-dev"; fi
}

# Run a command as root, or return 1 without asking for a password
as_root() {
    if [ "$(id -u)" -eq 0 ]; then "$@"; elif have sudo && sudo -n true 2>/dev/null; then sudo -n "$@"; else return 1; fi
}

# apt-get install, or say why not and return 1
apt() {
    if ! have apt-get; then
        say "no apt-get here, so these Debian packages, or what your system calls them, are left to you: $*"
    elif ! as_root true; then
        say "not root, and sudo would ask for a password; please run: sudo apt-get install $*"
    elif ! as_root apt-get update -qq || ! as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "$@"; then
        say "apt-get failed (its message is above; no network?); once it works, run: sudo apt-get install $*"
    else
        return 0
    fi
    return 1
}

# --- the virtual environment -------------------------------------------------------------------------------------

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { say "$python is older than 3.11; try: make PYTHON=python3.12"; exit 1; }
if [ ! -x .venv/bin/pip ]; then
    "$python" -c 'import ensurepip' 2>/dev/null || apt python3-venv || true
    "$python" -m venv .venv
fi
pip() { .venv/bin/python -m pip install --quiet --disable-pip-version-check "$@"; }

say "leadline and its development tools into .venv"
pip --editable '.[dev,dask]'

# --- SuiteSparse: the fast solvers, if they can be had -----------------------------------------------------------

need=$(missing)
if [ -n "$need" ]; then
    say "SuiteSparse's fast solvers need: $need"
    # shellcheck disable=SC2086 # several names
    apt $need || true
fi

without="leadline works without them, with the slower lu solver. To have them:
  Debian, Ubuntu:  sudo apt-get install $packages gcc python3-dev
  conda:           conda install suitesparse
  Homebrew:        brew install suite-sparse
and then:          .venv/bin/python -m pip install -e '.[cholmod]'"

if ! header cholmod.h || ! header SuiteSparseQR_C.h; then
    loudly "CHOLMOD and SPQR were NOT installed: the headers of SuiteSparse (cholmod.h, SuiteSparseQR_C.h) are not there." "$without"
    exit 0
fi

say "scikit-sparse and sparseqr (compiled here: about a minute)"
if pip --editable '.[cholmod]' && .venv/bin/python -c 'import sksparse.cholmod, sparseqr'; then
    say "done; linear solvers: cholesky (CHOLMOD), qr (SPQR), lu (SuperLU) and the dense ones"
    openblas || loudly "OpenBLAS is missing: CHOLMOD works, but several times slower than it could." \
        "To cure it: sudo apt-get install libopenblas0"
else
    loudly "CHOLMOD and SPQR could NOT be installed; the reason is above." "$without"
fi
