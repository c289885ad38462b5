"""Mail to the maintainers. It is sent after the commit, and a mail that cannot be sent changes nothing."""

import smtplib
import uuid
from email.message import EmailMessage

import structlog

from server import submissions
from server.services import Services
from server.settings import Settings

log = structlog.get_logger(__name__)


def tell_of_failure(services: Services, submission_id: uuid.UUID) -> bool:
    """Tell the maintainers that a submission failed.

    Returns:
        False when no mail was sent: none is wanted, or the mail server did not take it.
    """
    settings = services.settings
    if not (settings.smtp_host and settings.maintainers_email):
        return False
    with services.snapshot() as session:
        submission = submissions.find(session, submission_id)
        place = f"{submission.phase.benchmark.slug}/{submission.phase.slug}"
        text = (
            f"Submission {submission.id} of team {submission.team.slug} to {place} failed"
            f" after {submission.attempt} attempts.\n\n"
            f"Cause: {submission.failure_code}\n{submission.failure_detail}\n\n"
            f"{settings.public_url.rstrip('/')}/submissions/{submission.id}\n"
            f"When the cause is gone: cs3d-admin requeue {submission.id}\n"
        )
        subject = f"[cs3d] submission to {place} failed: {submission.failure_code}"
    return send(settings, to=settings.maintainers_email, subject=subject, text=text)


def tell_of_hold(services: Services, submission_id: uuid.UUID) -> bool:
    """Tell the maintainers that a submission waits for their look; nothing when it is not held.

    Returns:
        False when no mail was sent.
    """
    settings = services.settings
    if not (settings.smtp_host and settings.maintainers_email):
        return False
    with services.snapshot() as session:
        submission = submissions.find(session, submission_id)
        if submission.held_reason is None:
            return False
        place = f"{submission.phase.benchmark.slug}/{submission.phase.slug}"
        text = (
            f"Submission {submission.id} of team {submission.team.slug} to {place} cannot be published before you look"
            f" at it.\n\n{submission.held_reason}\n\n{settings.public_url.rstrip('/')}/submissions/{submission.id}\n"
            f"To let it be published: cs3d-admin release {submission.id}\n"
        )
    return send(settings, to=settings.maintainers_email, subject=f"[cs3d] submission to {place} held", text=text)


def send(settings: Settings, *, to: str, subject: str, text: str) -> bool:
    """Send one mail.

    Returns:
        False when the mail server did not take it; that is logged, never raised.
    """
    message = EmailMessage()
    message["From"], message["To"], message["Subject"] = settings.mail_from, to, subject
    message.set_content(text)
    try:
        with smtplib.SMTP(settings.smtp_host, settings.smtp_port, timeout=settings.smtp_timeout_s) as smtp:
            if settings.smtp_starttls:
                smtp.starttls()
            if settings.smtp_user:
                smtp.login(settings.smtp_user, settings.smtp_password.get_secret_value())
            smtp.send_message(message)
    except (OSError, smtplib.SMTPException) as error:
        log.warning("mail_not_sent", to=to, error=repr(error))
        return False
    return True
