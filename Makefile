# The two commands of the README and their parts. Each can be repeated: what is there already is left alone.

help: ## List what can be made
	@sed -nE 's/^([a-z]+):.*## (.*)/make \1\t\2/p' Makefile

run: setup ## Set up what is missing, build, open the window
	cargo run --locked

test: ## Set up what is missing, then run all checks and tests
	@.ci/setup-system --test
	@.ci/setup-libtorch
	@.ci/check

setup: ## Install the missing system packages (with apt) and libtorch (into .libtorch)
	@.ci/setup-system
	@.ci/setup-libtorch

bench: setup ## Measure what a user feels: a plan, a dreamed step, the simulator
	cargo bench --locked --profile dev --bench '*'

dist: setup ## Build a folder that runs without Rust and libtorch, as dist/dropj-VERSION-linux-x86_64.tar.zst
	cargo build --locked
	@.ci/dist

.PHONY: help run test setup bench dist
