// Sends the form's archive as a raw body, with a progress bar; without this module the form works by itself.

const form = document.getElementById("submit");
const sending = document.getElementById("sending");
const stop = document.getElementById("stop");
const problem = document.getElementById("problem");

const size = (bytes) => `${(bytes / 2 ** 20).toFixed(1)} MiB`;

function showProgress(done, total) {
  sending.hidden = false;
  sending.querySelector("progress").value = total ? done / total : 0;
  const text = done < total ? `${size(done)} of ${size(total)} sent` : "Sent; the archive is being checked.";
  sending.querySelector("[data-text]").textContent = text;
}

function showProblem(document_) {
  problem.hidden = false;
  problem.querySelector("[data-title]").textContent = `${document_.title}.`;
  problem.querySelector("[data-detail]").textContent = document_.detail;
  const list = problem.querySelector("[data-list]");
  const groups = document_.report ? document_.report.groups : [];
  list.replaceChildren(
    ...groups.flatMap((group) =>
      group.problems.slice(0, 20).map((place) => {
        const item = document.createElement("li");
        const parts = [place.file, place.pointer, place.found && `found ${place.found}`, place.detail];
        item.textContent = `${group.title} ${parts.filter(Boolean).join(" · ")}. ${group.fix}`;
        return item;
      }),
    ),
  );
  problem.scrollIntoView({ block: "nearest" });
}

function setBusy(busy) {
  form.querySelector("button.primary").disabled = busy;
  stop.hidden = !busy;
  if (!busy) sending.hidden = true;
}

function readProblem(request) {
  try {
    return JSON.parse(request.responseText);
  } catch {
    return { title: "The server did not take the upload", detail: `It answered with status ${request.status}; send it again.` };
  }
}

const broken = { title: "No answer came", detail: "The connection broke; send it again. What did arrive is not made a second time." };

// Kept until an answer comes or the form is changed: sending again after a break makes no second submission.
let key = null;

function send() {
  const fields = new FormData(form);
  const file = fields.get("predictions");
  const query = new URLSearchParams({
    benchmark: form.dataset.benchmark,
    phase: form.dataset.phase,
    method: fields.get("method"),
    method_name: fields.get("method_name"),
    description: fields.get("description"),
    paper_url: fields.get("paper_url"),
    code_url: fields.get("code_url"),
    team: fields.get("team"),
    file_name: file.name,
  });
  // fetch cannot tell how much of a body is sent; XMLHttpRequest can.
  const request = new XMLHttpRequest();
  request.open("POST", `/api/v1/submissions?${query}`);
  request.setRequestHeader("Content-Type", "application/zip");
  request.setRequestHeader("X-CSRF-Token", fields.get("csrf"));
  key ??= crypto.randomUUID ? crypto.randomUUID() : String(Math.random());
  request.setRequestHeader("Idempotency-Key", key);
  request.upload.addEventListener("progress", (event) => showProgress(event.loaded, event.total));
  request.addEventListener("load", () => {
    key = null;
    if (request.status === 202) {
      window.location.assign(JSON.parse(request.responseText).links.page);
      return;
    }
    setBusy(false);
    showProblem(readProblem(request));
  });
  request.addEventListener("error", () => {
    setBusy(false);
    showProblem(broken);
  });
  request.addEventListener("abort", () => setBusy(false));
  stop.addEventListener("click", () => request.abort(), { once: true });
  problem.hidden = true;
  setBusy(true);
  showProgress(0, file.size);
  request.send(file);
}

if (form) {
  form.addEventListener("input", () => {
    key = null;
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    send();
  });
}
