# course.mk - the course: examples/course/index.html, its checks, the exercises and the ladder. Part of the Makefile.

COURSE := examples/course
COURSE_PARTS := $(COURSE)/course.html $(COURSE)/course.css $(COURSE)/course.js $(COURSE)/exercises.txt
WASM_CC ?= clang
# -nostdinc: only the headers in math/ and wasm/, and the compiler's own (stdint.h, stddef.h).
WASM_FLAGS := --target=wasm32 -std=c99 -O2 -ffp-contract=off -mbulk-memory -nostdlib -nostdinc -isystem $(COURSE)/math -isystem $(COURSE)/wasm
.PHONY: course course-page course-check exercises ladder

course: $(BUILD)/course/index.html ## builds examples/course/index.html, the interactive course (Debian: clang, lld)
	cp $< $(COURSE)/index.html
course-page: $(BUILD)/course/index.html
$(BUILD)/course/course.wasm: $(COURSE)/course.c reference/splat.c src/core/vecmath.h $(wildcard $(COURSE)/math/*.h $(COURSE)/wasm/*.h) $(COURSE)/course.mk
	@mkdir -p $(@D)
	$(WASM_CC) $(WASM_FLAGS) -isystem $$($(WASM_CC) -print-resource-dir)/include \
	  -Wl,--no-entry -Wl,--export-dynamic -Wl,--strip-all -Wl,-z,stack-size=262144 $< -o $@
$(BUILD)/course/page: $(COURSE)/page.c
	@mkdir -p $(@D)
	$(CC) -std=c99 -O1 $(WARN) $< -o $@
$(BUILD)/course/index.html: $(BUILD)/course/page $(BUILD)/course/course.wasm $(COURSE_PARTS) $(wildcard src/*/*.c)
	$(BUILD)/course/page $(COURSE)/course.html $(BUILD)/course/course.wasm "$$($(WASM_CC) --version | head -n 1)" > $@

course-check: $(BUILD)/course/numbers $(BUILD)/course/numbers_libm ## checks that the committed course matches its sources, and that its numbers in a headless browser are those of the native build
	$(COURSE)/check.sh $(BUILD)/course
$(BUILD)/course/numbers $(BUILD)/course/numbers_libm: $(COURSE)/numbers.c $(COURSE)/course.c $(COURSE)/math/math.h reference/splat.c src/core/vecmath.h
	@mkdir -p $(@D)
	$(CC) -std=c99 -O2 $(FLOATS) $(WARN) $(if $(findstring libm,$@),-DCOURSE_LIBM,-isystem $(COURSE)/math) $< -o $@ -lm

# exercise-N compiles the student's copy of splat.c with its check. If the check says 0 (exercises.c), the copy trains with the images of the
# unchanged program, so its errors show in build/exercises/N/splat.bmp.
EXERCISES_AT ?= $(BUILD)/exercises
PICTURE ?= 1
EXERCISE := $(addprefix exercise-,1 2 3 4 5 6 7 8 9 10)
.PHONY: $(EXERCISE)
exercises: ## checks the course's ten exercises (make exercise-1 .. exercise-10): each refuses splat.c and accepts its solution
	$(COURSE)/exercises.sh $(BUILD)/course/exercises
$(EXERCISE): exercise-%:
	@mkdir -p $(EXERCISES_AT)
	@[ -e $(EXERCISES_AT)/$*.c ] || cp reference/splat.c $(EXERCISES_AT)/$*.c
	@$(CC) -std=c99 -O1 -DEXERCISE=$* -DSTUDENT='"$(EXERCISES_AT)/$*.c"' -I. $(COURSE)/exercises.c -o $(EXERCISES_AT)/$*.check -lm
	@$(EXERCISES_AT)/$*.check $(COURSE)/exercises.txt; check=$$?; \
	[ $$check -lt 10 ] || exit 0; [ $$check = 0 ] || exit 1; [ "$(PICTURE)" != 0 ] || exit 0; \
	$(MAKE) -s --no-print-directory $(BUILD)/unchanged.log && mkdir -p $(EXERCISES_AT)/$* && \
	$(CC) -O2 -Ireference $(EXERCISES_AT)/$*.c -o $(EXERCISES_AT)/$*/splat -lm && \
	before=$$(sed -n 's/^view.*: //p' $(BUILD)/unchanged.log) && cd $(EXERCISES_AT)/$* && \
	./splat "$(abspath $(BUILD)/splat.truth)" | sed -n "s/^view.*: \(.*\)/  trained   held-out view: \1; unchanged: $$before/p" && \
	echo "  files     $(EXERCISES_AT)/$*/splat.bmp: the truth above, the result below; unchanged: $(BUILD)/splat.bmp"
$(BUILD)/unchanged.log: $(BUILD)/splat # and splat.truth, splat.bmp beside it
	@cd $(BUILD) && ./splat >unchanged.log

ladder: $(BUILD)/liboceanxl.a ## measures times and differences of seven renderers of one scene, from plain loops to the library (half a minute)
	@LIBS='$(LIBS)' $(COURSE)/ladder.sh $(BUILD)/ladder $(CC) -std=c99 -O3 $(FLOATS) $(THREADS)
