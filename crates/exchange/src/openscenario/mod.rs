//! Import of ASAM OpenSCENARIO XML 1.0 to 1.3: entities that drive in the middle of lanes of a straight road; and
//! [`export`].
//!
//! 1. [`xml`](self) elements with lines are read with the values of the parameters;
//! 2. the storyboard becomes events with triggers and actions;
//! 3. a replay gives each scripted entity its speeds over time and its lane changes;
//! 4. the vehicles that are ever in the lane of the vehicle under test become a [`Scenario`].
//!
//! Content that a scenario cannot represent is an error that names the element, its line and the reason.

mod alternations;
mod constructs;
mod distribution;
mod element;
mod entities;
mod error;
pub mod export;
#[cfg(test)]
mod hostile_tests;
mod initial;
mod interpreter;
mod lane_scenario;
mod lateral;
mod limits;
mod missing_road;
mod parameters;
mod path_actions;
mod place;
mod quantity;
mod recorded;
mod replay;
mod replay_state;
mod report;
mod resolution;
mod road;
mod route;
mod scopes;
mod source;
mod space;
mod speed_plan;
#[cfg(test)]
mod story_tests;
mod storyboard;
mod taut_path;
#[cfg(test)]
mod tests;
mod trajectory;
mod trajectory_action;
mod trigger;
mod variables;
mod vocabulary;
mod xml;

use std::path::{Path, PathBuf};
use std::rc::Rc;

pub use constructs::{KnownConstruct, known_constructs};
pub use distribution::{MAX_VARIATIONS, ParameterDistributionFile, Variation};
pub use entities::{DELAY_PROPERTIES, UNDER_TEST_CONTROLLER};
pub use error::ScenarioImportError;
pub use report::OpenScenarioReport;
pub use xml::{MAX_XML_BYTES, MAX_XML_ITEMS};

use self::constructs::ActionDomains;
use self::element::StoryElement;
use self::entities::Entity;
use self::initial::InitialState;
use self::lane_scenario::LaneScenarioBuilder;
use self::limits::{WORK_PER_ITEM, WorkBudget};
use self::parameters::Parameters;
use self::replay::{EntityControl, EntityMotion, Replay, ReplayStart};
use self::road::RoadMap;
use self::scopes::StoryScopes;
use self::source::{FileCache, SourceFiles};
use self::trigger::Firing;
use self::variables::StoryVariables;
use self::xml::{Node, SourceElement};
use crumple_sim::scenario::{Driver, Scenario};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// First part of the description in the header of crumple's export.
pub(crate) const DESCRIPTION_START: &str = "crumple scenario ";
/// Part of the description between the name and the purpose of the scenario, for actions.
pub(crate) const ABOUT_ACTIONS: &str =
    "what the scripted vehicles do; the others are left to controllers";
/// Part of the description before the purpose of the scenario.
pub(crate) const DESCRIPTION_ABOUT: &str = " The scenario: ";

/// An OpenSCENARIO file, and the files to which it refers.
#[derive(Debug)]
pub struct OpenScenarioSource {
    path: PathBuf,
    root: Rc<SourceElement>,
    files: FileCache,
    work: WorkBudget,
}

/// An imported scenario.
#[derive(Debug)]
pub struct ImportedLaneScenario {
    /// Scenario on one lane.
    pub scenario: Scenario,
    /// File, line and name of the last action of the motion with the most samples, for the error of a scenario whose
    /// file would be too large.
    pub largest_motion: String,
    /// Content without influence on the scenario, and assumptions, each with its line.
    pub notes: Vec<String>,
}

impl OpenScenarioSource {
    /// Reads a file.
    ///
    /// # Errors
    /// [`ScenarioImportError`] for a file that cannot be read, is not well-formed, or exceeds [`MAX_XML_BYTES`] or
    /// [`MAX_XML_ITEMS`].
    pub fn load(path: &Path) -> Result<Self> {
        let files = FileCache::new(true);
        Ok(Self {
            path: path.to_owned(),
            root: files.load(path, "OpenSCENARIO")?,
            files,
            work: WorkBudget::new(),
        })
    }

    /// Parses a file with its road, without reading others.
    ///
    /// # Errors
    /// [`ScenarioImportError::Syntax`] for a text that is not well-formed.
    pub fn from_bytes(scenario: &[u8], road: &[u8]) -> Result<Self> {
        let (files, path) = (FileCache::new(false), Path::new("f.xosc"));
        files.parse(road, Path::new("f.xodr"), "OpenDRIVE")?;
        let root = files.parse(scenario, path, "OpenSCENARIO")?;
        Ok(Self {
            path: path.to_owned(),
            root,
            files,
            work: WorkBudget::new(),
        })
    }

    /// Interprets the file as a scenario on one lane. `ego` names the entity under test; without it, that is the only
    /// entity with an assigned controller. `assigned` replaces values of parameters.
    ///
    /// # Errors
    /// [`ScenarioImportError`] names the file, the line, the element and the reason. The work of all calls together is
    /// limited (`docs/exchange.md`).
    pub fn scenario(
        &self,
        ego: Option<&str>,
        assigned: &[(String, String)],
    ) -> Result<ImportedLaneScenario> {
        let none = Parameters::default();
        let root = Node {
            element: &self.root,
            parameters: &none,
        };
        self.work
            .spend(root, WORK_PER_ITEM * self.files.items() as u64)?;
        let parameters = declared_parameters(root, assigned)?;
        let root = Node {
            parameters: &parameters,
            ..root
        };
        check_content(root)?;
        let header = root.child("FileHeader")?;
        check_version(header)?;
        self.interpret(root, header, ego)
    }

    /// Interprets the elements of a file, which have the values of the parameters.
    fn interpret(
        &self,
        root: Node<'_>,
        header: Node<'_>,
        ego: Option<&str>,
    ) -> Result<ImportedLaneScenario> {
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let files = SourceFiles::new(&self.files, folder, root.optional("CatalogLocations"))?;
        let storyboard = root.child("Storyboard")?;
        storyboard.only(&["Init", "Story", "StopTrigger"], &[])?;
        let (road, road_note) = self.road(root.child("RoadNetwork")?, storyboard, &files)?;
        let roads = RoadMap::new(&road, &self.work);
        let list = root.child("Entities")?;
        let mut entities = entities::read_entities(list, &files)?;
        let omitted = entities::remove_placeholders(&mut entities, storyboard);
        let drivers = entities::assign_drivers(list, &entities, ego)?;
        let initial = initial::read_initial(storyboard, &entities, &roads, &files, &self.work)?;
        entities::turn(&mut entities, &initial.turned_rad);
        let scopes = StoryScopes::read(storyboard, &files)?;
        let content = ReplayedContent {
            root,
            storyboard,
            entities: &entities,
            drivers: &drivers,
            roads: &roads,
            files: &files,
            scopes: &scopes,
            work: &self.work,
            notes: road_note.into_iter().chain(omitted).collect(),
        };
        let (replay, stop) = content.replay_all(initial)?;
        let builder = LaneScenarioBuilder {
            storyboard,
            replay,
            drivers: drivers.clone(),
            stop,
            name: self.scenario_name(header),
            about: purpose(header),
        };
        builder.build()
    }

    /// Returns the road file. Without one, the road is straight and has the lanes that the storyboard states.
    fn road(
        &self,
        network: Node<'_>,
        storyboard: Node<'_>,
        files: &SourceFiles<'_>,
    ) -> Result<(Rc<SourceElement>, Option<String>)> {
        network.only(
            &["LogicFile", "SceneGraphFile", "TrafficSignals", "UsedArea"],
            &[],
        )?;
        let file = network.optional("LogicFile");
        if let Some(road) = file.map(|file| files.road(file)).transpose()?.flatten() {
            return Ok((road, None));
        }
        let node = file.unwrap_or(network);
        let road = missing_road::replacement(node, storyboard)?;
        let note = node.note(road.about);
        Ok((files.replacement_road(&road.text)?, Some(note)))
    }

    /// Returns the name of the scenario: that of crumple's export, or that of the file.
    fn scenario_name(&self, header: Node<'_>) -> String {
        let name = match exported_description(header) {
            Some((name, _)) => name.to_owned(),
            None => {
                let stem = self.path.file_stem().unwrap_or_default();
                stem.to_string_lossy().into_owned()
            }
        };
        let name: String = name
            .chars()
            .filter(|letter| !letter.is_control())
            .take(200)
            .collect();
        if name.is_empty() {
            "imported".to_owned()
        } else {
            name
        }
    }
}

/// Content of a file that a replay needs.
struct ReplayedContent<'a, 'b> {
    root: Node<'a>,
    storyboard: Node<'a>,
    entities: &'b [Entity<'a>],
    drivers: &'b [Option<Driver>],
    roads: &'b RoadMap<'b>,
    files: &'b SourceFiles<'b>,
    scopes: &'a StoryScopes,
    work: &'b WorkBudget,
    /// Notes about the road and omitted entities.
    notes: Vec<String>,
}

impl<'a, 'b> ReplayedContent<'a, 'b> {
    /// Replays the storyboard, and returns the replay and its end. A controller that is never activated drives from the
    /// start.
    fn replay_all(&self, initial: InitialState<'a>) -> Result<(Replay<'a, 'b>, Firing)> {
        let (replay, stop) = self.replay(initial, true)?;
        if !replay.motion.iter().any(EntityMotion::is_inactive) {
            return Ok((replay, stop));
        }
        let (node, entities) = (self.storyboard, self.entities);
        let initial = initial::read_initial(node, entities, self.roads, self.files, self.work)?;
        self.replay(initial, false)
    }

    /// Replays the storyboard, and returns the replay and its end. With `awaits_activation`, the default controller
    /// drives a vehicle under test until an event activates its controller.
    fn replay(
        &self,
        mut initial: InitialState<'a>,
        awaits_activation: bool,
    ) -> Result<(Replay<'a, 'b>, Firing)> {
        let stories = storyboard::read_stories(self.storyboard, self.entities, self.scopes)?;
        initial.notes.extend(self.notes.iter().cloned());
        initial.notes.extend(stories.notes);
        initial
            .notes
            .extend(self.unknown_controllers(&stories.elements)?);
        let is_activated = |entity: usize| {
            let elements = stories.elements.iter();
            let is_active = initial.is_active.get(entity).copied().unwrap_or_default();
            !is_active && elements.clone().any(|element| element.activates(entity))
        };
        let control = self.drivers.iter().enumerate();
        let control = control.map(|(entity, driver)| EntityControl {
            is_controlled: driver.is_some(),
            awaits_activation: awaits_activation
                && *driver == Some(Driver::UnderTest)
                && is_activated(entity),
        });
        let control = control.collect();
        let start = ReplayStart {
            initial,
            elements: stories.elements,
            variables: StoryVariables::new(self.root, self.root.parameters)?,
            control,
        };
        let mut replay = Replay::new(
            self.entities,
            start,
            (self.roads, self.files),
            self.work,
            self.storyboard,
        )?;
        let stop = replay.run(stories.conditions, self.storyboard)?;
        Ok((replay, stop))
    }
}

impl ReplayedContent<'_, '_> {
    /// Returns notes about scripted entities with a controller that crumple does not know. Refuses those of which no
    /// action of an event controls the speed: only their controller determines their motion.
    fn unknown_controllers(&self, elements: &[StoryElement<'_>]) -> Result<Vec<String>> {
        let mut notes = Vec::new();
        for (entity, driver) in self.drivers.iter().enumerate() {
            let Some(body) = self.entities.get(entity).filter(|_| driver.is_none()) else {
                continue;
            };
            let Some(controller) = body.unknown_controller() else {
                continue;
            };
            let name = &body.name;
            let problem =
                format!("`{name}` has the controller `{controller}`, which is none of crumple's");
            let mut actions = elements
                .iter()
                .filter(|element| element.actors.contains(&entity));
            if !actions.any(|action| action.domains.overlaps(ActionDomains::LONGITUDINAL)) {
                return Err(body.node.refuse(problem));
            }
            notes.push(
                body.node
                    .note(format!("{problem}: the default controller drives it")),
            );
        }
        Ok(notes)
    }
}

/// Returns the values of the parameters, of which `assigned` replaces some.
fn declared_parameters(root: Node<'_>, assigned: &[(String, String)]) -> Result<Parameters> {
    let declarations = root.optional("ParameterDeclarations");
    let parameters = Parameters::declare(declarations, assigned)?;
    match assigned.iter().find(|(name, _)| !parameters.contains(name)) {
        Some((name, _)) => Err(declarations
            .unwrap_or(root)
            .refuse(format!("there is no parameter `{name}`"))),
        None => Ok(parameters),
    }
}

/// Refuses a file that is no scenario, or has unknown elements at its top.
fn check_content(root: Node<'_>) -> Result<()> {
    if root.optional("ParameterValueDistribution").is_some() {
        return Err(root.refuse(
            "is a file of distributions: give it with --distribution, after its scenario",
        ));
    }
    root.only(
        &[
            "FileHeader",
            "ParameterDeclarations",
            "VariableDeclarations",
            "MonitorDeclarations",
            "CatalogLocations",
            "RoadNetwork",
            "Entities",
            "Storyboard",
        ],
        &[],
    )
}

fn check_version(header: Node<'_>) -> Result<()> {
    let minor = header.number("revMinor")?;
    if header.number("revMajor")? != 1.0 || !(0.0..=3.0).contains(&minor) {
        return Err(header.refuse("only versions 1.0 to 1.3 are supported"));
    }
    Ok(())
}

/// Returns the name of the scenario and the rest of the description, if crumple has exported the file.
fn exported_description<'a>(header: Node<'a>) -> Option<(&'a str, &'a str)> {
    header
        .raw("description")?
        .strip_prefix(DESCRIPTION_START)?
        .split_once(": what ")
}

/// Returns the purpose of the scenario: that of crumple's export, or the file's description.
fn purpose(header: Node<'_>) -> String {
    let about = match exported_description(header) {
        Some((_, rest)) => rest
            .split_once(DESCRIPTION_ABOUT)
            .map_or("", |(_, about)| about),
        None => header.raw("description").unwrap_or_default(),
    };
    about.to_owned()
}
