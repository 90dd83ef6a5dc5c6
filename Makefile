# Two commands set everything up on a fresh Debian or Ubuntu with Python 3.11 or newer:
#   make demo    the whole pipeline on generated chairs, then the window (pictures only without a screen)
#   make test    the tests (15 minutes at most on 2 cores); make test-all adds the long ones
# PYTHON=… chooses the interpreter of .venv.

SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help demo test test-all lint format setup clean

help:
	@sed -n 's/^# \{0,1\}//p' Makefile | head -4
	@echo "  make setup   only what both do first: the virtual environment .venv and the system's libraries"
	@echo "  make lint    ruff, the rules of pyproject.toml;  make format lays the code out"

demo: .venv/.packages
	@.ci/setup-libraries || echo "Going on without a window: pictures may be missing." >&2
	.venv/bin/shapeforge demo demo

test: .venv/.packages .venv/.libraries
	@.ci/test -m "not slow" -q

test-all: .venv/.packages .venv/.libraries
	@.ci/test -q

lint: .venv/.packages
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .

format: .venv/.packages
	.venv/bin/ruff check --fix .
	.venv/bin/ruff format .

setup: .venv/.packages .venv/.libraries

# Stamps: once made, a repeat costs nothing; they are redone when what they were made from changes.
.venv/.packages: pyproject.toml constraints.txt .ci/setup-python
	@PYTHON="$(PYTHON)" .ci/setup-python
	@touch $@

.venv/.libraries: .ci/setup-libraries .venv/.packages
	@.ci/setup-libraries
	@touch $@

clean:
	rm -rf .venv demo build *.egg-info .pytest_cache .ruff_cache .hypothesis
