//! Names of files and materials as a terminal shows them.
//!
//! A name may hold any character. An escape sequence in it would command the terminal, and a line feed would
//! break the table that it stands in.

use std::borrow::Cow;

/// Whether a terminal shows the character as it is, neither obeying it nor turning the text around it.
#[must_use]
pub fn is_printable(character: char) -> bool {
    // Separators of lines and paragraphs; marks that turn the direction of writing.
    let is_layout = matches!(character, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    !character.is_control() && !is_layout
}

/// A text with what is not printable as Rust escapes it: `\n`, `\u{1b}`.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    escape(text, is_printable)
}

/// A text of several lines: as [`printable`], but for the line feeds.
#[must_use]
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    escape(text, |character| character == '\n' || is_printable(character))
}

fn escape(text: &str, passes: impl Fn(char) -> bool) -> Cow<'_, str> {
    if text.chars().all(&passes) {
        return Cow::Borrowed(text);
    }
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        if passes(character) {
            escaped.push(character);
        } else {
            escaped.extend(character.escape_default());
        }
    }
    Cow::Owned(escaped)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_commands_a_terminal_is_escaped_and_the_rest_is_not() {
        assert_eq!(printable("a\u{1b}[31mred\nb"), "a\\u{1b}[31mred\\nb");
        assert_eq!(printable("\u{9b}\u{7f}\u{202e}\r\t"), "\\u{9b}\\u{7f}\\u{202e}\\r\\t");
        assert_eq!(printable_lines("one\ntwo\u{7}\n"), "one\ntwo\\u{7}\n");
        for text in ["", "chm_orange", "grün \"5°\"", "布"] {
            assert!(matches!(printable(text), Cow::Borrowed(_)));
        }
    }
}
