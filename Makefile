PYTHON ?= python3
BIN := .venv/bin

SECONDS ?= 1800
SEED ?= 1

.PHONY: demo test check docs bench fuzz clean

demo: .venv/demo
	$(BIN)/python examples/demo.py

# with coverage and its floor, see pyproject.toml; a process for each core, each of one thread
test: .venv/dev
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/pytest --numprocesses auto --cov --cov-report=

check: .venv/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: .venv/dev
	$(BIN)/mkdocs build --strict

# the tables of the docs, beside other packages; twenty minutes on two idle cores
bench: .venv/dev
	for question in 'eigensolver --rounds 2' 'descriptors --rounds 2' refinement 'match --rounds 1' growth; do \
	  set -- $$question; echo "$$1:"; $(BIN)/python benchmarks/$$1.py $$2 $$3 $(if $(PEERS),--peers $(PEERS)) || exit 1; \
	done

.venv/demo: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[viz]'
	touch $@

.venv/dev: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

fuzz: .venv/dev
	$(BIN)/pip install --quiet 'atheris>=2.3'
	mkdir -p fuzz
	$(BIN)/python tools/fuzz.py -seed=$(SEED) -max_total_time=$(SECONDS) -max_len=12000 -timeout=20 -rss_limit_mb=4096 -artifact_prefix=fuzz/

clean:
	rm -rf .venv demo dist fuzz site docs/pictures
