//! Parameters of stories and maneuvers, and maneuvers of catalogues.

use super::error::ScenarioImportError;
use super::limits::ensure_at_most;
use super::parameters::Parameters;
use super::source::{CatalogEntry, SourceFiles};
use super::xml::{Node, SourceElement};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Maximum number of stories and maneuvers that declare parameters, and of maneuvers of catalogues.
const MAX_SCOPES: usize = 50;

/// Parameters of stories and maneuvers that declare some, and maneuvers of catalogues, each by its element in the file.
#[derive(Debug, Default)]
pub(super) struct StoryScopes {
    parameters: Vec<(*const SourceElement, Parameters)>,
    maneuvers: Vec<(*const SourceElement, CatalogEntry)>,
}

impl StoryScopes {
    /// Reads the parameters and the maneuvers of all stories.
    pub(super) fn read(storyboard: Node<'_>, files: &SourceFiles<'_>) -> Result<Self> {
        let mut scopes = Self::default();
        for story in storyboard.named("Story") {
            scopes.add(storyboard, story)?;
            let own = scopes.last_of(story);
            let story = Node {
                parameters: own.as_ref().unwrap_or(story.parameters),
                ..story
            };
            let groups = story
                .named("Act")
                .flat_map(|act| act.named("ManeuverGroup"));
            for child in groups.flat_map(Node::children) {
                match child.name() {
                    "Maneuver" => scopes.add(storyboard, child)?,
                    "CatalogReference" => {
                        let entry = files.catalog_entry(child, &["Maneuver"])?;
                        let what = "maneuvers of catalogues";
                        let count = scopes.maneuvers.len() + 1;
                        ensure_at_most(storyboard, count, MAX_SCOPES, what)?;
                        scopes
                            .maneuvers
                            .push((std::ptr::from_ref(child.element), entry));
                    }
                    _ => {}
                }
            }
        }
        Ok(scopes)
    }

    /// Adds the parameters that an element declares.
    fn add(&mut self, storyboard: Node<'_>, node: Node<'_>) -> Result<()> {
        let Some(list) = node.optional("ParameterDeclarations") else {
            return Ok(());
        };
        if list.children().next().is_none() {
            return Ok(());
        }
        let what = "stories and maneuvers with parameters";
        ensure_at_most(storyboard, self.parameters.len() + 1, MAX_SCOPES, what)?;
        let parameters = node.parameters.extended(list)?;
        self.parameters
            .push((std::ptr::from_ref(node.element), parameters));
        Ok(())
    }

    /// Returns the parameters that were added last, if they are those of an element.
    fn last_of(&self, node: Node<'_>) -> Option<Parameters> {
        let (element, parameters) = self.parameters.last()?;
        std::ptr::eq(*element, node.element).then(|| parameters.clone())
    }

    /// Returns an element with the values of the parameters that it declares.
    pub(super) fn enter<'a>(&'a self, node: Node<'a>) -> Node<'a> {
        let mut scopes = self.parameters.iter();
        let scope = scopes.find(|(element, _)| std::ptr::eq(*element, node.element));
        Node {
            parameters: scope.map_or(node.parameters, |(_, parameters)| parameters),
            ..node
        }
    }

    /// Returns the maneuver of an element or of the catalogue to which it refers; `None` for another element.
    pub(super) fn maneuver<'a>(&'a self, node: Node<'a>) -> Result<Option<Node<'a>>> {
        match node.name() {
            "Maneuver" => Ok(Some(self.enter(node))),
            "CatalogReference" => {
                let mut entries = self.maneuvers.iter();
                let entry = entries.find(|(element, _)| std::ptr::eq(*element, node.element));
                entry.map(|(_, entry)| entry.node(node)).transpose()
            }
            _ => Ok(None),
        }
    }
}
