/* report_verdict.c - says in words what the figures of the evaluated views mean.
 *
 * The grade is the lower of two: of structure, the correlation of detail, and of explained contrast, the
 * share of the images' variance that the model accounts for. PSNR takes no part: it is high where images are
 * dark or even, whatever the model shows.
 *
 * The limits are chosen, not derived: round numbers between drafts of eight surveys, which were looked at. By
 * structure and explained contrast, caliterra 0.99, 0.97 and subvo_pool 0.98, 0.96 are very good; synth 0.93,
 * 0.94, haltbrekken_a 0.92, 0.88 and seneca 0.88, 0.89 good; brighton_beach, 15 images, 0.62, 0.80 poor. No
 * survey at hand is fair by structure (0.70 to 0.85) but the ridge of synth, at its upper end: 0.85, 0.87.
 */
#include "report_state.h"

#include <math.h>
#include <string.h>

/* Says that the model fits its training images only, from this gap of structure to held-out views on. */
#define VERDICT_GAP 0.08
/* Says that errors of new views are larger, though their detail is the same, from so many dB on. */
#define VERDICT_GAP_PSNR 1.0
/* Says how much of the error is brightness, where one factor a channel mends so many dB. */
#define VERDICT_EXPOSURE 0.5

struct verdict {
    double structure, explained; /* least values of the grade; explained: share of the variance */
    const char *word, *mark, *meaning;
};

static const struct verdict VERDICTS[] = {
    {0.95, 0.90, "very good", "good", "renderings show nearly all the detail of the images"},
    {0.85, 0.80, "good", "good", "renderings show the detail of the images, the finest of it softer"},
    {0.70, 0.60, "fair", "warn", "shapes are right, fine detail is missing; fit for an overview"},
    {0.50, 0.30, "poor", "warn", "large shapes alone are right; not fit for measuring"},
    {-1, -HUGE_VAL, "not usable", "warn", "renderings do not look like the images"},
};

static const struct verdict *verdict_of(double structure, double explained)
{
    const struct verdict *v = VERDICTS;
    while (v->structure >= 0 && !(structure >= v->structure && explained >= v->explained)) v++;
    return v;
}

static void verdict_gap(struct report *r, double psnr, double structure)
{
    struct output *t = &r->page;
    const char *training = oxl_json_member(r->metrics, "training");
    const double seen = oxl_json_number(training, "structure"), seen_psnr = oxl_json_number(training, "psnr");
    if (!isfinite(seen) || !isfinite(structure)) return;
    output_add(t, "<li>Training views: structure %.2f", seen);
    if (isfinite(seen_psnr))
        output_add(t, ", %.2f dB (%.2f dB more than held-out views)", seen_psnr, seen_psnr - psnr);
    output_add(
        t,
        seen - structure > VERDICT_GAP
            ? ". <b class=\"warn\">New views are worse than those trained on</b>: images overlap too little, or "
              "their poses disagree.</li>\n"
        : seen_psnr - psnr > VERDICT_GAP_PSNR
            ? ". New views show about as much detail as those trained on, but their errors are larger.</li>\n"
            : ". New views are about as good as those trained on.</li>\n");
}

static int verdict_is_on(const char *value)
{
    return value && strncmp(value, "\"on\"", 4) == 0;
}

/* Returns 1 if a part of the model was trained with a switch on: as set, or as was decided for "auto". */
static int verdict_has(const struct report *r, const char *name)
{
    int on = verdict_is_on(oxl_json_member(r->job, name));
    for (int k = 0; k < r->parts; k++) {
        const char *decision = oxl_json_member(oxl_json_member(r->block[k].json, "decisions"), name);
        on |= verdict_is_on(oxl_json_member(decision, "chosen"));
    }
    return on;
}

/* Says what other viewers lack, and the options of train that this comes from. */
static void verdict_viewers(struct report *r, double plain)
{
    struct output *t = &r->page;
    const int exposure = verdict_has(r, "exposure"), lamp = verdict_has(r, "lamp"),
              medium = verdict_has(r, "medium");
    output_add(t, "<li>Other viewers show scene.ply alone: ");
    if (exposure || lamp)
        output_add(t, "%s%s%s, ", exposure ? "at mean exposure" : "", exposure && lamp ? " and " : "",
                   lamp ? "by even light" : "");
    if (medium) output_add(t, "with the medium in the colours of the Gaussians, ");
    output_add(t, "%.2f dB against these images.", plain);
    if (exposure || lamp)
        output_add(
            t, " Trained with <code>%s%s%s</code> a model differs less from them in a viewer, and more here.",
            exposure ? "--exposure off" : "", exposure && lamp ? " " : "", lamp ? "--lamp off" : "");
    else if (medium)
        output_add(t, " Light through the medium depends on distance, which colours alone do not follow: "
                      "<code>oceanxl render</code> shows it.");
    output_add(t, "</li>\n");
}

static void verdict_list(struct report *r, double structure, double share)
{
    struct output *t = &r->page;
    const double psnr = oxl_json_number(r->metrics, "psnr"), cc = oxl_json_number(r->metrics, "cc_psnr"),
                 fog = oxl_json_number(r->metrics, "no_structure"),
                 least = oxl_json_number(r->metrics, "structure_least"),
                 plain = oxl_json_number(r->metrics, "plain_psnr"),
                 aligned = oxl_json_number(r->metrics, "aligned_psnr");
    const char *split = oxl_json_member(r->metrics, "split");
    output_add(
        t,
        "<ul>\n<li>Structure %.2f: correlation of the detail of image and rendering (1: the same, 0: a veil)",
        structure);
    if (isfinite(least)) output_add(t, "; %.2f in the worst view", least);
    output_add(t, ".</li>\n");
    if (isfinite(share))
        output_add(
            t, "<li>Explained contrast %.0f %%: what the model accounts for of the images' variance.</li>\n",
            100 * fmax(share, 0));
    if (fog > 0)
        output_add(t, "<li><b class=\"warn\">%.0f %s no structure</b>, see below.</li>\n", fog,
                   fog > 1 ? "views have" : "view has");
    output_add(t,
               "<li>PSNR %.2f dB: compare it between runs of one survey only; dark or even images have more.",
               psnr);
    if (isfinite(cc)) {
        output_add(
            t,
            " After one factor a channel and view, which mends exposure and white balance, it is %.2f dB (cc-PSNR)",
            cc);
        if (cc - psnr > VERDICT_EXPOSURE)
            output_add(t, ": about %.0f %% of the squared error is brightness or colour of whole views",
                       100 * (1 - pow(10, (psnr - cc) / 10)));
        output_add(t, ".");
    }
    if (isfinite(aligned))
        output_add(
            t,
            " Training moved cameras; held-out ones moved onto their images likewise have %.2f dB: what is "
            "between is error of their poses.",
            aligned);
    output_add(t, "</li>\n");
    if (psnr - plain >= REPORT_VIEWER_LOSS) verdict_viewers(r, plain);
    if (split && strncmp(split, "\"test\"", 6) == 0) verdict_gap(r, psnr, structure);
    output_add(t, "</ul>\n");
}

void verdict_section(struct report *r)
{
    const double structure = oxl_json_number(r->metrics, "structure"),
                 explained = oxl_json_number(r->metrics, "explained"), share = 1 - pow(10, -explained / 10);
    const struct verdict *v = verdict_of(structure, isfinite(explained) ? share : HUGE_VAL);
    if (!r->metrics || !isfinite(structure)) return; /* a run from before structure was measured has none */
    page_section(r, "Verdict");
    output_add(&r->page, "<p><b class=\"%s\">Image quality: %s.</b> In the mean of the views, %s.</p>\n",
               v->mark, v->word, v->meaning);
    verdict_list(r, structure, share);
}
