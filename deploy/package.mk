# Packages: built, installed without the source tree, and booted.
#
## make deb        the Debian packages for amd64 and arm64, installed without a network: build/deb (minutes, needs a package index)
## make boot       boots systemd in a container with the package installed; writes docs/boot.md (needs root, debootstrap, systemd-container)
## make test-package  builds wheel and sdist, installs each without the source tree and runs it (minutes, needs a package index)
## make mavlink    writes the MAVLink messages in use, with pymavlink's generator
## make page-vendor  installs the libraries of the live page in the versions of its package-lock.json and copies the files it uses (needs npm)

.PHONY: deb boot test-package mavlink page-vendor

# Wheels of all base dependencies come from the package index; ARCHITECTURES="arm64" and REVISION=2 choose.
ARCHITECTURES = amd64 arm64
REVISION = 1
deb: .venv/fly.ready
	$(BIN)/python -m deploy.debian.build --architectures $(ARCHITECTURES) --revision $(REVISION)

# The root of the container is made once and kept in build/boot. Times are measured: without other load.
boot: .venv/fly.ready
	$(BIN)/python -m deploy.boot --out docs/boot.md

# Downloads all dependencies twice.
test-package: .venv/test.ready
	$(BIN)/pytest -v --durations 10 tests/packaging

# A message that the code is to use is added to the list in companion/mavlink/generate.py.
mavlink: .venv/fly.ready
	$(BIN)/python -m companion.mavlink.generate

# The page works offline: what it uses of these libraries is committed.
PAGE_VENDOR = companion/monitor/page/vendor
page-vendor:
	rm -rf build/page-vendor && mkdir -p build/page-vendor
	cp $(PAGE_VENDOR)/package.json $(PAGE_VENDOR)/package-lock.json build/page-vendor
	cd build/page-vendor && npm ci --silent --ignore-scripts --no-audit --no-fund
	rm -rf $(PAGE_VENDOR)/lit-html $(PAGE_VENDOR)/uplot && mkdir -p $(PAGE_VENDOR)/lit-html/directives $(PAGE_VENDOR)/uplot
	cd build/page-vendor/node_modules/lit-html && cp LICENSE lit-html.js directive.js directive-helpers.js $(CURDIR)/$(PAGE_VENDOR)/lit-html
	cp build/page-vendor/node_modules/lit-html/directives/repeat.js $(PAGE_VENDOR)/lit-html/directives
	mkdir -p tests/page/vendor/axe-core
	cd build/page-vendor/node_modules/axe-core && cp LICENSE LICENSE-3RD-PARTY.txt axe.min.js $(CURDIR)/tests/page/vendor/axe-core
	cd build/page-vendor/node_modules/uplot && cp LICENSE dist/uPlot.esm.js dist/uPlot.min.css $(CURDIR)/$(PAGE_VENDOR)/uplot
