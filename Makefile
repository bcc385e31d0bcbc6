# OceanXL - `make help` lists the targets. GNU make; a C99 compiler; stb (Debian: libstb-dev).

# DEV=1: for work on the code: objects in build/dev at -O1, for a debugger, for this machine's vectors alone. Without it
# nothing is kept for a debugger: that costs a fifth of the build.
DEV    ?=
CFLAGS ?= $(if $(DEV),-O1 -g,-O3)
WERROR ?=
BUILD  ?= $(if $(DEV),build/dev,build)
PREFIX ?= /usr/local
# stb/: what the source archive of a release has.
STB    ?= $(if $(wildcard stb/stb_image.h),stb)

# Part of the result: a fused or reordered operation changes bytes, and a lying isnan() hides divergence. So neither
# -ffast-math nor -march=native, ever; the kernels choose AVX2 or AVX-512 at run time by themselves (src/core/simd.h).
FLOATS := -ffp-contract=off -fno-math-errno -fno-trapping-math
WARN   := -Wall -Wextra -pedantic $(if $(WERROR),-Werror)
ifneq ($(findstring clang,$(shell $(CC) --version 2>/dev/null)),)
WARN   += -Wno-error=pass-failed # a loop that this optimizer left scalar: worth a line, not a stop
endif
SYSTEM := libstb-dev zlib1g-dev gcc make libc6-dev
# As the program sets it for itself (wait_passively in main.c).
export OMP_WAIT_POLICY ?= passive
export GOMP_SPINCOUNT ?= 500

# OPENMP=0 builds the serial program; without a word, OpenMP is used when the compiler has it.
OPENMP ?= $(shell mkdir -p $(BUILD); echo 'int main(void) { return omp_get_max_threads() < 1; }' | \
            $(CC) -fopenmp -include omp.h -x c - -o $(BUILD)/probe 2>/dev/null && echo 1 || echo 0)
OPENMP := $(OPENMP)
THREADS := $(if $(filter 0,$(OPENMP)),-fopenmp-simd,-fopenmp)

# STB=path: a folder that holds stb_image.h, or a folder stb/ that does.
STB_FLAGS := $(if $(STB),-I$(STB) -I$(BUILD)/include)

# VULKAN=1: with the Vulkan backend. Wants headers (Debian: libvulkan-dev); the program itself needs none: it loads Vulkan at run time.
VULKAN ?=
VULKAN_FLAGS := $(if $(filter-out 0,$(VULKAN)),-DOXL_VULKAN)

# ZLIB=0: stb deflates, not zlib (Debian: zlib1g-dev), which is used when the compiler finds it.
ZLIB   ?= $(shell echo 'int main(void) { return !zlibVersion(); }' | \
            $(CC) -include zlib.h -x c - -o $(BUILD)/probe -lz 2>/dev/null && echo 1 || echo 0)
ZLIB   := $(ZLIB)
ZLIB_FLAGS := $(if $(filter-out 0,$(ZLIB)),-DOXL_ZLIB)

DEV_FLAGS := $(if $(DEV),-DOXL_ONE_ISA=$(shell grep -qw avx512bw /proc/cpuinfo 2>/dev/null && echo 2 || \
               { grep -qw avx2 /proc/cpuinfo 2>/dev/null && echo 1 || echo 0; }))

BASE  = -std=c99 $(WARN) $(FLOATS) $(THREADS) $(STB_FLAGS) $(VULKAN_FLAGS) $(ZLIB_FLAGS) $(DEV_FLAGS)
FLAGS = $(CFLAGS) $(BASE)
LIBS  = $(LDFLAGS) -lm $(if $(ZLIB_FLAGS),-lz) $(if $(VULKAN_FLAGS),-ldl)

CLI     := $(wildcard cli/*.c tools/*.c)
LAB     := $(wildcard lab/*.c)
VULKAN_C := $(if $(VULKAN_FLAGS),$(wildcard backends/vulkan/*.c))
MODULES := $(wildcard src/*/*.c) $(VULKAN_C)
LIBRARY := $(MODULES:%.c=$(BUILD)/%.o)
SOURCES := $(wildcard oceanxl.[ch] oceanxl_job.h src/*/*.[ch] backends/vulkan/*.[ch] cli/*.[ch] tools/*.[ch] lab/*.[ch])
TESTS   := $(sort $(filter-out tests/test.c,$(wildcard tests/test_*.c)))
OURS    := $(wildcard *.c *.h src/*/*.[ch] backends/vulkan/*.[ch] cli/*.[ch] tools/*.[ch] lab/*.[ch] tests/*.[ch] bench/*.[ch] fuzz/*.[ch] examples/*.c examples/course/*.c examples/course/*/*.[ch] examples/playground/*.c examples/playground/wasm/*.h reference/*.[ch])
EXAMPLES := $(patsubst examples/%.c,$(BUILD)/examples/%,$(wildcard examples/*.c))

.PHONY: all help unity without shared python rooms man test extremes fuzz coverage mutate races portable demo setup bench cost floaters borders heights reference shaders shaders-check modules dist release sanitize examples format format-check install clean FORCE
.DELETE_ON_ERROR:

all: $(BUILD)/oceanxl $(BUILD)/oceanxl-lab ## builds build/oceanxl, the program, and build/oceanxl-lab, which it executes for synthetic surveys and studies (the default)

help: ## prints this list
	@echo 'make TARGET [CC=clang] [CFLAGS=-O3] [OPENMP=0] [ZLIB=0] [VULKAN=1] [STB=folder] [WERROR=1] [BUILD=build]'
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  \1\t\2/p' Makefile examples/course/course.mk examples/playground/playground.mk | expand -t 20

# ------------------------------------------------------------------------------------------------ program, library

$(BUILD)/oceanxl: $(BUILD)/main.o $(CLI:%.c=$(BUILD)/%.o) $(LIBRARY)
	$(CC) $(FLAGS) $^ -o $@ $(LIBS)
$(BUILD)/oceanxl-lab: $(LAB:%.c=$(BUILD)/%.o) $(CLI:%.c=$(BUILD)/%.o) $(LIBRARY)
	$(CC) $(FLAGS) $^ -o $@ $(LIBS)

# The page of results names the commit: its object follows when that changes. A release says which it is.
LAB_COMMIT ?= $(shell git describe --always --dirty --exclude '*' 2>/dev/null)
$(BUILD)/commit: FORCE
	@mkdir -p $(@D)
	@echo '$(LAB_COMMIT)' | cmp -s - $@ || echo '$(LAB_COMMIT)' > $@
$(BUILD)/lab/results.o: BASE += -DLAB_COMMIT='"$(LAB_COMMIT)"'
$(BUILD)/lab/results.o: $(BUILD)/commit

# The library as one translation unit, whose internal names are static: what is installed.
unity: $(BUILD)/unity/oceanxl ## builds the program with the library as one translation unit, which takes a minute and gives the same bytes
$(BUILD)/unity/oceanxl: $(BUILD)/main.o $(CLI:%.c=$(BUILD)/%.o) $(BUILD)/oceanxl.o
	@mkdir -p $(@D)
	$(CC) $(FLAGS) $^ -o $@ $(LIBS)
$(BUILD)/liboceanxl.a: $(BUILD)/oceanxl.o
	$(AR) rcs $@ $^

$(BUILD)/%.o: %.c $(BUILD)/flags
	@mkdir -p $(@D)
	$(CC) $(if $(filter tests/test% tests/cases.c,$<),$(TEST_CFLAGS) -I$(BUILD),$(CFLAGS)) $(BASE) -MMD -MP -c $< -o $@

# Objects depend on this: it changes with the compiler and its flags. A missing stb is said in one line, before the compiler
# says it in twenty; STB=folder is linked to a name that #include <stb/stb_image.h> finds.
$(BUILD)/flags: FORCE
	@mkdir -p $(BUILD)/include
	@$(if $(STB),ln -sfn $(abspath $(STB)) $(BUILD)/include/stb)
	@echo '#include <stb/stb_image.h>' | $(CC) $(BASE) -E -x c - >/dev/null 2>&1 || { \
	  echo 'oceanxl: $(CC) found no stb/stb_image.h. fix: make setup (as root), apt-get install libstb-dev, or make STB=folder' >&2; \
	  exit 1; }
	@echo '$(CC) $(FLAGS)' | cmp -s - $@ || { echo '$(CC) $(FLAGS)' > $@; \
	  $(CC) $(FLAGS) -dM -E -x c /dev/null | awk '/ __i386__ / { x86 = 1 } / __SSE2_MATH__ / { sse = 1 } END { exit !x86 || sse }' && \
	  echo "oceanxl: warning: 32 bits without SSE2 are 8 times as slow. fix: make CC='$(CC) -msse2 -mfpmath=sse'" >&2 || :; }

# ------------------------------------------------------------------------------------------------ tests

test: $(BUILD)/test all ## runs all tests, of the library and of the command line (under 3 minutes on 2 cores); build/test WORD runs those of the library whose name has WORD
	tests/share.sh $(BUILD)/test
	tests/cli.sh $(BUILD)/oceanxl
	tests/from_images.sh

# The list is made from the lines that begin with TEST( and replaced only when it changes.
$(BUILD)/test_list.h: FORCE
	@mkdir -p $(BUILD)
	@! grep -nE '^(DEVICE_)?TEST\([^),]*$$' $(TESTS) # a name on a line of its own is not in the list
	@cat $(TESTS) /dev/null | sed -nE 's/^(DEVICE_)?TEST\(([A-Za-z0-9_]+)[,)].*/\1ENTRY(\2)/p' > $(BUILD)/test_list.new
	@cmp -s $(BUILD)/test_list.new $@ || mv $(BUILD)/test_list.new $@

# The reference and the kernels in double: units of their own, see tests/wide.h.
WIDE := $(BUILD)/tests/wide_splat.o $(BUILD)/tests/wide_kernels.o $(BUILD)/tests/wide_scenes.o
TEST_CFLAGS = $(if $(filter -O3,$(CFLAGS)),-O1,$(CFLAGS)) # of the tests themselves: they are to be built fast
TEST_O := $(patsubst %.c,$(BUILD)/%.o,tests/test.c tests/cases.c $(TESTS))
$(BUILD)/tests/test.o: $(BUILD)/test_list.h
$(BUILD)/test: $(TEST_O) $(WIDE) $(filter-out $(BUILD)/backends/%,$(LIBRARY)) # the backend is in test_vulkan.o
	$(CC) $(FLAGS) $^ -o $@ $(LIBS)

coverage: ## prints which lines and branches of src/ the tests reach (gcov)
	tests/coverage.sh
mutate: ## changes the kernels one place at a time, and lists the changes that the tests do not detect (a quarter of an hour)
	tests/mutate.sh
races: ## runs the library's tests under ThreadSanitizer (clang with libomp-dev)
	tests/races.sh $(T)
portable: ## runs tests for other machines under those of qemu, musl, mingw-w64 and tcc that are installed
	tests/portable.sh

SANITIZE := -fsanitize=address,undefined -fno-sanitize-recover=undefined -fno-omit-frame-pointer
sanitize: ## runs the library's tests under the address and undefined-behaviour sanitizers
	$(MAKE) BUILD=$(BUILD)/sanitize CFLAGS='-O1 -g $(SANITIZE)' $(BUILD)/sanitize/test
	printf 'leak:libomp\n' >$(BUILD)/sanitize/ours # What clang's OpenMP keeps for its threads is not ours.
	ASAN_OPTIONS=detect_leaks=1 LSAN_OPTIONS=suppressions=$(CURDIR)/$(BUILD)/sanitize/ours tests/share.sh $(BUILD)/sanitize/test $(T)

reference: $(BUILD)/splat ## builds reference/splat.c, the algorithm in one file, and trains its scene: build/splat.ply and build/splat.bmp
	cd $(BUILD) && ./splat
$(BUILD)/splat: reference/splat.c reference/scene.h
	$(CC) -O2 $< -o $@ -lm
BENCH_OF := $(BUILD)/bench$(if $(filter vulkan,$(BACKEND)),_device)
bench: $(BENCH_OF) ## measures the time of each stage of a training step, and pairs per second against the machine's ceiling; VULKAN=1 BACKEND=vulkan measures a device
	$(BENCH_OF) $(BENCH)

extremes: $(BUILD)/extremes ## measures the tables of docs/STABILITY.md: the kernels at the extremes, float against double (minutes)
	@rm -rf $(BUILD)/surveys
	$(BUILD)/extremes $(BUILD)/surveys > $(BUILD)/STABILITY.md
	mv $(BUILD)/STABILITY.md docs/STABILITY.md

# libFuzzer comes with clang. Inputs that are kept lie in fuzz/corpus; what is found goes to build/fuzz/NAME, crashes beside it.
SECONDS ?= 10
SEED ?= 0
RUNS ?= -1
FUZZ_CC ?= clang
FUZZ_TARGETS := $(notdir $(wildcard fuzz/corpus/*))
FUZZ_RUNS := $(addprefix fuzz-,$(FUZZ_TARGETS))
.PHONY: $(FUZZ_RUNS)
fuzz: $(FUZZ_RUNS) ## gives random input to each reader of files for SECONDS (10) under libFuzzer, in parallel with -j; FUZZ_TARGETS=ply selects one; SEED=1 RUNS=9000 repeats the same inputs
$(FUZZ_RUNS): fuzz-%: $(BUILD)/fuzz/fuzz
	@mkdir -p $(BUILD)/fuzz/$*
	@OXL_FUZZ=$* $< -max_total_time=$(SECONDS) -runs=$(RUNS) -seed=$(SEED) -max_len=4096 -timeout=20 -rss_limit_mb=2048 -print_final_stats=1 \
	  -artifact_prefix=$(BUILD)/fuzz/crash-$*- $(BUILD)/fuzz/$* fuzz/corpus/$* > $(BUILD)/fuzz/$*.log 2>&1 || \
	  { tail -n 25 $(BUILD)/fuzz/$*.log; exit 1; }
	@echo "fuzz $*"; grep -ah -e 'cov: ' -e number_of_executed $(BUILD)/fuzz/$*.log | tail -n 2
FUZZ_SANITIZE := -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=undefined,float-cast-overflow
$(BUILD)/fuzz/fuzz: fuzz/fuzz.c fuzz/targets.c $(SOURCES)
	@mkdir -p $(@D)
	$(FUZZ_CC) -std=c99 -O1 -g $(FLOATS) -DOXL_NO_SIMD -Wno-unknown-pragmas -fsanitize=fuzzer $(FUZZ_SANITIZE) -I. \
	  fuzz/fuzz.c $(filter-out cli/arguments.c cli/options.c cli/console.c lab/main.c,$(CLI) $(LAB)) -o $@ -lm

cost: $(BUILD)/cost ## builds build/cost SCENE, which measures how a step's time grows with Gaussians, pixels, views, bands and threads
floaters: $(BUILD)/floaters ## builds build/floaters IMAGES SURVEY, which counts floaters in a model's images of a synthetic survey (docs/log/TRAINING.md)
heights: $(BUILD)/heights ## builds build/heights MAX_SIDE MODEL SURVEY, which compares rendered depths with points and truth (docs/log/TRAINING.md)
$(BUILD)/heights: SOURCE = bench/heights.c
borders: $(BUILD)/borders ## builds build/borders MAX_SIDE SURVEY BLOCKS OUT..., which compares PSNR near borders between blocks (docs/SCALE.md)
$(BUILD)/borders: SOURCE = bench/borders.c
$(BUILD)/floaters: SOURCE = bench/floaters.c
$(BUILD)/cost: SOURCE = bench/cost.c
$(BUILD)/bench: SOURCE = bench/bench.c
$(BUILD)/bench_device: SOURCE = bench/device.c
$(BUILD)/extremes: SOURCE = tests/extremes.c
$(BUILD)/vulkan_compile: SOURCE = tests/vulkan_compile.c
$(BUILD)/extremes: $(WIDE) $(LIBRARY)
$(BUILD)/bench $(BUILD)/bench_device $(BUILD)/cost $(BUILD)/extremes $(BUILD)/floaters $(BUILD)/borders $(BUILD)/heights $(BUILD)/vulkan_compile: \
  bench/bench.c bench/device.c bench/cost.c tests/extremes.c bench/floaters.c bench/borders.c bench/heights.c tests/vulkan_compile.c $(BUILD)/flags
	$(CC) $(FLAGS) -I. -MMD -MP -MT $@ -MF $@.d $(SOURCE) $(filter %.o,$^) -o $@ $(LIBS)

examples: $(EXAMPLES) ## builds the programs of examples/ in build/examples
$(BUILD)/examples/%: examples/%.c $(BUILD)/liboceanxl.a
	@mkdir -p $(@D)
	$(CC) $(FLAGS) -I. -MMD -MP -MT $@ -MF $@.d $< $(BUILD)/liboceanxl.a -o $@ $(LIBS)

shaders: ## compiles backends/vulkan/shaders into backends/vulkan/generated/spirv.h (Debian: glslc)
	backends/vulkan/shaders.sh
shaders-check: ## fails when the committed SPIR-V does not match the shaders
	backends/vulkan/shaders.sh check

# ------------------------------------------------------------------------------------------------ other ways to build

rooms: ## checks that includes in src/ go downwards only, line counts, and where code outside src/parts names a part of training
	scripts/rooms.sh
	scripts/parts.sh

without: ## PART=lamp removes a part of training, its file and its row, in a copy of the tree, and tests the rest; WORDS="train_ job_" selects tests
	scripts/without.sh $(PART) $(WORDS)

modules: $(LIBRARY) ## checks in the objects that no file calls a higher layer, and that no files call each other in a cycle
	scripts/rooms.sh links $(BUILD)

dist: $(BUILD)/dist/single $(BUILD)/dist/job ## writes dist/single/oceanxl.h, the trainer in one header, and dist/oceanxl_job.c, the job on top of it; compiles and runs both
	$(BUILD)/dist/single
	$(BUILD)/dist/job --version
$(BUILD)/dist/single: examples/one_gaussian.c dist/single/oceanxl.h
	$(CC) $(FLAGS) -Werror -Idist/single -DOCEANXL_IMPLEMENTATION $< -o $@ $(LIBS)
	$(CC) -std=c99 $(WARN) -Werror $(STB_FLAGS) -fsyntax-only -Idist/single -DOCEANXL_IMPLEMENTATION $< # as a user may, without OpenMP
$(BUILD)/dist/job: main.c $(CLI) dist/oceanxl_job.c
	$(CC) $(FLAGS) -Werror $^ -o $@ $(LIBS)
dist/oceanxl_job.c dist/single/oceanxl.h &: scripts/dist.sh $(SOURCES) $(BUILD)/flags
	@mkdir -p $(BUILD)/dist
	scripts/dist.sh dist

release: ## writes to build/release: zips with programs for Linux (x86-64, aarch64) and Windows, viewer, course, playground and documents; a source archive; check sums
	scripts/release.sh

format: ## formats our sources by clang-format
	@clang-format -i $(OURS)
format-check: ## fails when clang-format would change a file, or a line of src/, backends/vulkan/ or a header is longer than 110 columns, or one of README than 140
	@clang-format --dry-run -Werror $(OURS)
	@awk 'length > 110 && !/"|^#pragma|^#define VULKAN_OF|^    X\(|^    (1U|UINT64)/ { print FILENAME ":" FNR ": " length " columns, wanted at most 110"; bad = 1 } END { exit bad }' \
	  oceanxl.[ch] oceanxl_job.h $(filter-out src/core/options.c,$(wildcard src/*/*.[ch])) $(wildcard backends/vulkan/*.[ch])
	@awk 'length > 140 { print FILENAME ":" FNR ": " length " columns, wanted at most 140"; bad = 1 } END { exit bad }' README.md

# ------------------------------------------------------------------------------------------------ for users

setup: ## installs what the build needs (Debian, as root), or prints what that is
	@if echo '#include <stb/stb_image.h>' | $(CC) $(BASE) -E -x c - >/dev/null 2>&1; then echo 'setup: nothing is missing'; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  echo 'setup: apt-get install $(SYSTEM)'; apt-get update -qq && DEBIAN_FRONTEND=noninteractive \
	    apt-get install -y -qq --no-install-recommends -o Dpkg::Use-Pty=0 $(SYSTEM) >/dev/null; \
	else echo 'setup: as root: apt-get install $(SYSTEM)' >&2; exit 1; fi

demo: ## makes, trains and evaluates a synthetic survey, and writes images to demo/out (a few minutes)
	@$(MAKE) --no-print-directory setup
	@$(MAKE) --no-print-directory all
	@scripts/demo.sh $(BUILD)/oceanxl demo

man: $(BUILD)/oceanxl ## writes docs/oceanxl.1 and docs/OPTIONS.md from the tables of options (the tests fail when they are not current)
	$(BUILD)/oceanxl --man > $(BUILD)/oceanxl.1
	mv $(BUILD)/oceanxl.1 docs/oceanxl.1
	$(BUILD)/oceanxl --options-page > $(BUILD)/OPTIONS.md
	mv $(BUILD)/OPTIONS.md docs/OPTIONS.md

$(BUILD)/liboceanxl.so: oceanxl.c $(BUILD)/flags
	$(CC) $(FLAGS) -fPIC -shared -Wl,-soname,liboceanxl.so.0 -MMD -MP -MT $@ -MF $(BUILD)/shared.d $< -o $@ $(LIBS)
shared: $(BUILD)/liboceanxl.so ## builds the library for other languages
python: ## builds the library for python/oceanxl.py, whose structs and functions are generated from oceanxl.h
	@$(MAKE) --no-print-directory setup
	@$(MAKE) --no-print-directory $(BUILD)/liboceanxl.so
	python3 python/generate.py

# What install puts beside the program; versions of the library in one place, oceanxl.h.
VERSION := $(shell sed -n 's/^\#define OXL_VERSION "\(.*\)"$$/\1/p' oceanxl.h)
$(BUILD)/oceanxl.pc: Makefile oceanxl.h $(BUILD)/flags
	@printf '%s\n' 'prefix=$(PREFIX)' 'Name: oceanxl' 'Description: 3D Gaussian Splatting of underwater surveys' 'Version: $(VERSION)' \
	  'Cflags: -I$${prefix}/include' 'Libs: -L$${prefix}/lib -loceanxl $(filter -fopenmp,$(THREADS)) -lm $(if $(ZLIB_FLAGS),-lz) $(if $(VULKAN_FLAGS),-ldl)' > $@

install: all $(BUILD)/liboceanxl.a $(BUILD)/oceanxl.pc ## installs programs, manual page, headers, static library and pkg-config file under DESTDIR/PREFIX
	install -d $(DESTDIR)$(PREFIX)/bin $(DESTDIR)$(PREFIX)/include $(DESTDIR)$(PREFIX)/lib $(DESTDIR)$(PREFIX)/share/man/man1
	install -m 644 docs/oceanxl.1 $(DESTDIR)$(PREFIX)/share/man/man1/
	install -m 755 $(BUILD)/oceanxl $(BUILD)/oceanxl-lab $(DESTDIR)$(PREFIX)/bin/
	install -m 644 oceanxl.h oceanxl_job.h $(DESTDIR)$(PREFIX)/include/
	install -m 644 $(BUILD)/liboceanxl.a $(DESTDIR)$(PREFIX)/lib/
	install -d $(DESTDIR)$(PREFIX)/lib/pkgconfig
	install -m 644 $(BUILD)/oceanxl.pc $(DESTDIR)$(PREFIX)/lib/pkgconfig/

clean: ## removes build/ and dist/
	rm -rf $(BUILD) dist

include examples/course/course.mk
include examples/playground/playground.mk

-include $(shell find $(BUILD) -name '*.d' 2>/dev/null)
