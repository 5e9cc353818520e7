# What each target runs; change it here.
PYTHON ?= python3
DEMO = .venv/bin/python -m sim sphere --out demo && \
       .venv/bin/nls solve demo --plot demo/solved.png -o demo/solved.g2o
BENCHMARK = for script in pinv marginals schur scaling bundle; do .venv/bin/python benchmarks/$$script.py --quick --out build/benchmarks; done
EVIDENCE = $(sort $(wildcard benchmarks/evidence/*.py))
# Containers often set it; then each process of a test or a notebook compiles the library again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test lint docs sdist rooms benchmark evidence

help: ## this list
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' Makefile | expand -t 18

demo: .venv/installed ## simulate a graph, solve it, draw it: see the folder demo
	$(DEMO)

test: lint ## lint, then all tests and the examples in the docstrings
	.venv/bin/pytest -n auto --dist worksteal # neighbors in one process, which share what a module computes once

lint: .venv/installed ## formatting, ruff, mypy
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/mypy

# Four readers on two cores: they wait for kernels to start, and the last one is done sooner.
docs: .venv/docs-installed ## the site, notebooks executed, warnings fatal, then its links and pictures: docs/_build/html/index.html
	.venv/bin/sphinx-build -nW --keep-going -j 4 -b html docs docs/_build/html
	.venv/bin/python tools/check_site.py docs/_build/html

sdist: ## what the source distribution has: packages, licences, README with its pictures, no tests
	$(PYTHON) tools/check_sdist.py

rooms: .venv/installed ## code by room, and the storeys of nls
	.venv/bin/python tools/rooms.py

benchmark: .venv/installed ## has anything become slower? then small tables of speed, in build/benchmarks (4 minutes)
	.venv/bin/python benchmarks/guard.py
	@[ -z "$$LEADLINE_DATA" ] || .venv/bin/python benchmarks/posegraphs.py --gate
	@set -e; $(BENCHMARK)

evidence: .venv/installed ## every script of benchmarks/evidence, in order
	@set -e; for script in $(EVIDENCE); do echo "== $$script"; .venv/bin/python $$script; done
	@$(if $(EVIDENCE),:,echo "benchmarks/evidence has no scripts yet: nothing to run")

# .venv is made when it is needed and brought up to date when the requirements change.
.venv/installed: pyproject.toml tools/install.sh
	tools/install.sh $(PYTHON)
	@touch $@

.venv/docs-installed: .venv/installed
	.venv/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@
