# playground.mk - a survey trained on a page: build/playground/index.html. Part of the Makefile. Debian: clang, lld, wasi-libc, libclang-rt-14-dev-wasm32.

PLAYGROUND := examples/playground
WASI_CC ?= clang
WASI_FLAGS := --target=wasm32-wasi -std=c99 -O2 -msimd128 -fopenmp-simd $(FLOATS) -Wall -Wno-unknown-pragmas \
  -Wno-pass-failed -D_WASI_EMULATED_GETPID -isystem $(PLAYGROUND)/wasm -I$(BUILD)/playground/include -Idist/single -I.
PLAYGROUND_C := $(PLAYGROUND)/playground.c $(wildcard lab/synth*.c) cli/output.c cli/synth_options.c
.PHONY: wasm playground-check

wasm: $(BUILD)/playground/index.html ## builds build/playground/index.html, which trains a survey in a browser, in one file (Debian: clang, lld, wasi-libc, libclang-rt-14-dev-wasm32)
$(BUILD)/playground/%.o: %.c dist/single/oceanxl.h $(PLAYGROUND)/playground.mk
	@mkdir -p $(@D) $(BUILD)/playground/include
	@ln -sfn $(abspath $(or $(STB),/usr/include/stb)) $(BUILD)/playground/include/stb
	$(WASI_CC) $(WASI_FLAGS) -c $< -o $@
$(BUILD)/playground/playground.wasm: $(PLAYGROUND_C:%.c=$(BUILD)/playground/%.o)
	$(WASI_CC) --target=wasm32-wasi -mexec-model=reactor -Wl,--strip-all -Wl,-z,stack-size=1048576 $^ -lwasi-emulated-getpid -o $@
$(BUILD)/playground/index.html: $(PLAYGROUND)/index.html $(BUILD)/playground/playground.wasm
	@{ sed '/<!-- wasm -->/,$$d' $<; printf '<script id="wasm" type="text/plain">'; base64 -w 0 $(BUILD)/playground/playground.wasm; \
	  printf '</script>\n'; sed '1,/<!-- wasm -->/d' $<; } > $@

playground-check: $(BUILD)/playground/index.html $(BUILD)/oceanxl ## checks that the page in a headless browser gives the bytes of the native base build
	tests/playground.sh $(BUILD)
