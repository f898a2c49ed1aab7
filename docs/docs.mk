# The documentation. `make docs` is in the main Makefile.
#
## make docs-check  reports generated parts of docs/ that are not current
## make docs-words  words of the pages that are written by hand
## make site       builds the browsable documentation into build/site (needs npm, for the diagrams)
## make pictures   flies the scenarios of docs/scenarios.md in virtual time and draws them again
## make screenshots  the pictures of docs/monitor.md and docs/report.md, in Debian's Chromium (two minutes)

.PHONY: docs-check docs-words site pictures screenshots

docs-check: .venv/fly.ready
	$(BIN)/python docs/generate/pages.py --check

docs-words: .venv/fly.ready
	$(BIN)/python docs/generate/words.py

site: .venv/site.ready docs-check
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "build/site/index.html"

# What README and docs show of scenarios flown in virtual time: the same pictures to the last bit wherever they are made.
PICTURES = aggregation ring_figure_8 formations moving_target leaving turning_column fence_and_obstacles
pictures: .venv/fly.ready
	for scenario in $(PICTURES); do \
	  $(BIN)/sitl run config/scenarios/$$scenario.yaml --quiet --out runs/pictures/$$scenario && \
	  cp runs/pictures/$$scenario/from_above.png docs/images/$$scenario.png || exit 1; \
	done
	$(BIN)/sitl run config/scenarios/platoon.yaml --quiet --compare average_22 --out runs/pictures/platoon
	cp runs/pictures/platoon/comparison.png docs/images/platoon_comparison.png

# The flight of the report has a finding: for a moment the network loses a vehicle.
screenshots: .venv/test.ready
	$(BIN)/sitl run config/scenarios/formations.yaml --quiet --record --out runs/pictures/report \
	  --set 'links.partitions=[{vehicles: [8], from_s: 40, until_s: 40.45}]'
	$(BIN)/companion report runs/pictures/report
	$(BIN)/python tests/page/screenshots.py

# Scripts of the site: Mermaid draws the diagrams, iframe-worker searches pages that are opened as files. They become part of
# the site, so that its pages request nothing from the network.
SCRIPTS = mermaid@11.12.0 iframe-worker@1.0.4
.venv/site.ready: .venv/fly.ready
	@echo "Installing what the site needs into .venv ..."
	$(BIN)/$(PIP_INSTALL) --editable '.[ground,docs]'
	for script in $(SCRIPTS); do \
	  mkdir -p .venv/$${script%@*} && (cd .venv/$${script%@*} && tar xzf "$$(npm pack --silent $$script)") || exit 1; \
	done
	@touch $@
