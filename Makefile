# Two commands do everything on a machine with Python 3.11 (or later) and make:
#   make        environment, then the main job: runs with numbers beside exact values, pictures
#   make test   environment, then lint, types and tests
# and three write pages:
#   make paper  environment, then out/paper/index.html: the paper's claims, figures and verdicts
#   make docs   environment, then out/site/index.html: the documentation, and its tests
#   make notebooks  environment, then out/notebooks: the pages with code as notebooks
PYTHON ?= python3
BIN := .venv/bin

.PHONY: run test paper docs notebooks bench clean

run: .venv/installed
	mkdir -p out
	$(BIN)/hybrid run bouncing_ball --rtol 1e-12 --oracle --plot out/ball.png
	$(BIN)/hybrid run bead_on_table --set r=0.6 --set omega=3.5 --start x=1.5 --from 0 --until 7 \
	    --rtol 1e-10 --plot out/bead.png --save out/bead.nc
	@echo "Look at out/ball.png and out/bead.png."

test: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -n 2 --dist loadfile

paper: .venv/installed
	$(BIN)/hybrid report --out out/paper

docs: .venv/installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	HYBRID_SITE=out/site $(BIN)/python -m pytest -n 2 -m pages tests/test_docs.py tests/test_site.py

notebooks: .venv/installed
	$(BIN)/python docs/notebooks.py

bench: .venv/installed
	$(BIN)/python benchmarks/report.py

.venv/installed: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	touch $@

clean:
	rm -rf .venv out
