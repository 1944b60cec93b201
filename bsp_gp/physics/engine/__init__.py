"""The engine: equations of motion and their exact derivatives, integrated between events."""
