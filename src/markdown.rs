//! Tables of pages that are written in Markdown.

/// A table with a head, an empty line before and after it.
pub fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let names: Vec<String> = head.iter().map(|h| h.to_string()).collect();
    let rule: Vec<String> = head.iter().map(|_| "---".to_string()).collect();
    format!("\n{}{}{}\n", line(&names), line(&rule), rows.iter().map(|r| line(r)).collect::<String>())
}
