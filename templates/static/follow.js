// Follows a submission that is not done: shows its progress, and loads the page anew when its state changes.

const section = document.getElementById("progress");
const bar = section.querySelector("progress");
const text = section.querySelector("[data-text]");

const STAGES = { validating: "Validating", scoring: "Scoring" };

function show(submission) {
  if (submission.state !== section.dataset.state) {
    window.location.reload();
    return;
  }
  const progress = submission.progress;
  if (!progress || !progress.images_total) return;
  bar.max = progress.images_total;
  bar.value = progress.images_done;
  text.textContent = `${STAGES[progress.stage] ?? progress.stage}: ${progress.images_done} of ${progress.images_total} images`;
}

const events = new EventSource(section.dataset.events);
events.addEventListener("submission", (event) => {
  const submission = JSON.parse(event.data);
  if (submission.terminal) events.close();
  show(submission);
});
